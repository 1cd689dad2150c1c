/* SPDX-License-Identifier: MIT */
#include "vk_host.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../btf_test.h"
#include "vk_device.h"

/* The export's macros move it to set 1; set 0 has the queries and the results. */
enum { GROUP = 64, BATCH = 4096, QUERY_FLOATS = 9, STORAGE_BUFFERS = 2 };

typedef struct vk_host {
  gpu_host host;
  vk_device device;
  vk_buffer queries, results, block;
  /* of the export that is loaded */
  vk_image images[FOLDER_MOST_TEXTURES];
  uint32_t image_count;
  VkDescriptorPool pool;
  VkDescriptorSetLayout set_layouts[2];
  VkDescriptorSet sets[2];
  VkPipelineLayout layout;
  VkPipeline pipeline;
} vk_host;

/* ---- the shader ---- */

static const char before[] = "#version 450\n"
                             "#define BTF_BINDING(n) layout(set = 1, binding = n)\n"
                             "#define BTF_BLOCK(n) layout(std140, set = 1, binding = n)\n";
static const char after[] =
    "layout(local_size_x = 64) in;\n"
    "layout(std430, set = 0, binding = 0) readonly buffer Queries { float query[]; };\n"
    "layout(std430, set = 0, binding = 1) writeonly buffer Results { float result[]; };\n"
    "void main() {\n"
    "  uint i = gl_GlobalInvocationID.x, q = 9u * i;\n"
    "  vec3 f = btf_eval(vec3(query[q], query[q + 1u], query[q + 2u]),\n"
    "                    vec3(query[q + 3u], query[q + 4u], query[q + 5u]),\n"
    "                    vec2(query[q + 6u], query[q + 7u]), query[q + 8u]);\n"
    "  result[3u * i] = f.x;\n"
    "  result[3u * i + 1u] = f.y;\n"
    "  result[3u * i + 2u] = f.z;\n"
    "}\n";

/* By the reference compiler. */
static const char *compile(const vk_host *h, const char *glsl, VkShaderModule *out) {
  char command[2048];
  size_t size = 0;
  FILE *file = fopen(test_path("shader.comp"), "wb");
  if (file == NULL) return "the shader cannot be written";
  fprintf(file, "%s%s%s", before, glsl, after);
  fclose(file);
  snprintf(command, sizeof command,
           "cd '%s' && { '%s' -V shader.comp -o shader.spv >shader.txt || { cat shader.txt; false; }; }",
           test_path("."), TEST_GLSLANG);
  if (system(command) != 0) return "the shader does not compile";
  unsigned char *code = test_read_bytes(test_path("shader.spv"), &size);
  const VkShaderModuleCreateInfo info = {.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO,
                                         .codeSize = size,
                                         .pCode = (const uint32_t *)(const void *)code};
  const VkResult result = vkCreateShaderModule(h->device.handle, &info, NULL, out);
  free(code);
  return result == VK_SUCCESS ? NULL : "Vulkan refuses the shader";
}

static bool make_layouts(vk_host *h, const gpu_folder *folder) {
  VkDescriptorSetLayoutBinding own[STORAGE_BUFFERS], bindings[FOLDER_MOST_TEXTURES + 1];
  for (uint32_t i = 0; i < STORAGE_BUFFERS; i++)
    own[i] = (VkDescriptorSetLayoutBinding){i, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1,
                                            VK_SHADER_STAGE_COMPUTE_BIT, NULL};
  bindings[0] = (VkDescriptorSetLayoutBinding){0, VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, 1,
                                               VK_SHADER_STAGE_COMPUTE_BIT, NULL};
  for (uint32_t i = 0; i < folder->texture_count; i++)
    bindings[i + 1] =
        (VkDescriptorSetLayoutBinding){folder->textures[i].binding, VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER,
                                       1, VK_SHADER_STAGE_COMPUTE_BIT, NULL};
  const VkDescriptorSetLayoutCreateInfo infos[2] = {
      {.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO,
       .bindingCount = STORAGE_BUFFERS,
       .pBindings = own},
      {.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO,
       .bindingCount = folder->texture_count + 1,
       .pBindings = bindings}};
  for (int s = 0; s < 2; s++)
    if (vkCreateDescriptorSetLayout(h->device.handle, &infos[s], NULL, &h->set_layouts[s]) != VK_SUCCESS)
      return false;
  const VkPipelineLayoutCreateInfo info = {.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO,
                                           .setLayoutCount = 2,
                                           .pSetLayouts = h->set_layouts};
  return vkCreatePipelineLayout(h->device.handle, &info, NULL, &h->layout) == VK_SUCCESS;
}

static const char *make_pipeline(vk_host *h, const char *glsl) {
  VkShaderModule shader = VK_NULL_HANDLE;
  const char *wrong = compile(h, glsl, &shader);
  if (wrong != NULL) return wrong;
  const VkComputePipelineCreateInfo info = {
      .sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO,
      .stage = {.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
                .stage = VK_SHADER_STAGE_COMPUTE_BIT,
                .module = shader,
                .pName = "main"},
      .layout = h->layout};
  const VkResult result =
      vkCreateComputePipelines(h->device.handle, VK_NULL_HANDLE, 1, &info, NULL, &h->pipeline);
  vkDestroyShaderModule(h->device.handle, shader, NULL);
  return result == VK_SUCCESS ? NULL : "Vulkan makes no pipeline of the shader";
}

static bool make_sets(vk_host *h, const gpu_folder *folder) {
  const VkDescriptorPoolSize sizes[] = {{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, STORAGE_BUFFERS},
                                        {VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, 1},
                                        {VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER, FOLDER_MOST_TEXTURES}};
  const VkDescriptorPoolCreateInfo info = {.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO,
                                           .maxSets = 2,
                                           .poolSizeCount = 3,
                                           .pPoolSizes = sizes};
  if (vkCreateDescriptorPool(h->device.handle, &info, NULL, &h->pool) != VK_SUCCESS) return false;
  const VkDescriptorSetAllocateInfo sets = {.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO,
                                            .descriptorPool = h->pool,
                                            .descriptorSetCount = 2,
                                            .pSetLayouts = h->set_layouts};
  if (vkAllocateDescriptorSets(h->device.handle, &sets, h->sets) != VK_SUCCESS) return false;
  const VkDescriptorBufferInfo buffers[] = {{h->queries.buffer, 0, VK_WHOLE_SIZE},
                                            {h->results.buffer, 0, VK_WHOLE_SIZE},
                                            {h->block.buffer, 0, VK_WHOLE_SIZE}};
  VkWriteDescriptorSet write = {.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET, .descriptorCount = 1};
  for (uint32_t i = 0; i < 3; i++) {
    const bool own = i < STORAGE_BUFFERS;
    write.dstSet = h->sets[own ? 0 : 1];
    write.dstBinding = own ? i : 0;
    write.descriptorType = own ? VK_DESCRIPTOR_TYPE_STORAGE_BUFFER : VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER;
    write.pBufferInfo = &buffers[i];
    vkUpdateDescriptorSets(h->device.handle, 1, &write, 0, NULL);
  }
  for (uint32_t i = 0; i < folder->texture_count; i++) {
    const VkDescriptorImageInfo image = {h->images[i].sampler, h->images[i].view,
                                         VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL};
    write.dstBinding = folder->textures[i].binding;
    write.descriptorType = VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER;
    write.pImageInfo = &image;
    vkUpdateDescriptorSets(h->device.handle, 1, &write, 0, NULL);
  }
  return true;
}

static void unload(vk_host *h) {
  vkDestroyPipeline(h->device.handle, h->pipeline, NULL);
  vkDestroyPipelineLayout(h->device.handle, h->layout, NULL);
  vkDestroyDescriptorPool(h->device.handle, h->pool, NULL);
  for (int s = 0; s < 2; s++) vkDestroyDescriptorSetLayout(h->device.handle, h->set_layouts[s], NULL);
  for (uint32_t i = 0; i < h->image_count; i++) vk_free_image(&h->device, &h->images[i]);
  h->pipeline = VK_NULL_HANDLE;
  h->layout = VK_NULL_HANDLE;
  h->pool = VK_NULL_HANDLE;
  h->image_count = 0;
  memset(h->set_layouts, 0, sizeof h->set_layouts);
}

static const char *load(gpu_host *host, const gpu_folder *folder) {
  vk_host *h = (vk_host *)host;
  const char *wrong = NULL;
  unload(h);
  for (uint32_t i = 0; wrong == NULL && i < folder->texture_count; i++) {
    h->image_count++;
    wrong = vk_make_image(&h->device, &folder->textures[i], &h->images[i]);
  }
  if (wrong != NULL) return wrong;
  memcpy(h->block.data, folder->block, folder->block_size);
  if (!make_layouts(h, folder) || !make_sets(h, folder)) return "Vulkan refuses the bindings";
  return make_pipeline(h, folder->glsl);
}

/* ---- queries ---- */

static bool dispatch(const vk_host *h) {
  /* The host reads what the shader has written. */
  const VkMemoryBarrier written = {.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER,
                                   .srcAccessMask = VK_ACCESS_SHADER_WRITE_BIT,
                                   .dstAccessMask = VK_ACCESS_HOST_READ_BIT};
  if (!vk_begin(&h->device)) return false;
  vkCmdBindPipeline(h->device.command, VK_PIPELINE_BIND_POINT_COMPUTE, h->pipeline);
  vkCmdBindDescriptorSets(h->device.command, VK_PIPELINE_BIND_POINT_COMPUTE, h->layout, 0, 2, h->sets, 0,
                          NULL);
  vkCmdDispatch(h->device.command, BATCH / GROUP, 1, 1);
  vkCmdPipelineBarrier(h->device.command, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0,
                       1, &written, 0, NULL, 0, NULL);
  return vk_finish(&h->device);
}

static const char *evaluate(gpu_host *host, const float *queries, size_t count, float *out) {
  vk_host *h = (vk_host *)host;
  while (count > 0) {
    const size_t n = count < BATCH ? count : BATCH;
    memset(h->queries.data, 0, BATCH * QUERY_FLOATS * sizeof(float));
    memcpy(h->queries.data, queries, n * QUERY_FLOATS * sizeof(float));
    if (!dispatch(h)) return "Vulkan does not run the shader";
    memcpy(out, h->results.data, n * 3 * sizeof(float));
    queries += QUERY_FLOATS * n;
    out += 3 * n;
    count -= n;
  }
  return NULL;
}

static bool make_buffers(vk_host *h) {
  const VkDeviceSize size = BATCH * sizeof(float);
  return vk_make_buffer(&h->device, size * QUERY_FLOATS, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT, &h->queries) &&
         vk_make_buffer(&h->device, size * 3, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT, &h->results) &&
         vk_make_buffer(&h->device, FOLDER_MOST_BLOCK, VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT, &h->block);
}

static void close_host(gpu_host *host) {
  vk_host *h = (vk_host *)host;
  if (h->device.handle != VK_NULL_HANDLE) {
    unload(h);
    vk_free_buffer(&h->device, &h->queries);
    vk_free_buffer(&h->device, &h->results);
    vk_free_buffer(&h->device, &h->block);
  }
  vk_close_device(&h->device);
  free(h);
}

gpu_host *vk_host_open(const char **why) {
  vk_host *h = calloc(1, sizeof *h);
  *why = "no memory";
  if (h == NULL) return NULL;
  h->host = (gpu_host){load, evaluate, close_host, ""};
  *why = vk_open_device(&h->device);
  if (*why == NULL && !make_buffers(h)) *why = "the Vulkan device has no buffers";
  memcpy(h->host.name, h->device.name, sizeof h->host.name);
  if (*why == NULL) return &h->host;
  close_host(&h->host);
  return NULL;
}
