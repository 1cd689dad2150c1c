/* SPDX-License-Identifier: MIT */
#include "vk_device.h"

#include <stdio.h>
#include <string.h>

/* ---- memory ---- */

static bool find_memory(const vk_device *d, uint32_t allowed, VkMemoryPropertyFlags wanted, uint32_t *type) {
  for (*type = 0; *type < d->memory.memoryTypeCount; ++*type)
    if ((allowed >> *type & 1) != 0 && (d->memory.memoryTypes[*type].propertyFlags & wanted) == wanted)
      return true;
  return false;
}

static bool allocate(const vk_device *d, const VkMemoryRequirements *needs, VkMemoryPropertyFlags wanted,
                     VkDeviceMemory *out) {
  VkMemoryAllocateInfo info = {.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO,
                               .allocationSize = needs->size};
  return find_memory(d, needs->memoryTypeBits, wanted, &info.memoryTypeIndex) &&
         vkAllocateMemory(d->handle, &info, NULL, out) == VK_SUCCESS;
}

bool vk_make_buffer(const vk_device *d, VkDeviceSize size, VkBufferUsageFlags usage, vk_buffer *out) {
  const VkBufferCreateInfo info = {
      .sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO, .size = size, .usage = usage};
  VkMemoryRequirements needs;
  if (vkCreateBuffer(d->handle, &info, NULL, &out->buffer) != VK_SUCCESS) return false;
  vkGetBufferMemoryRequirements(d->handle, out->buffer, &needs);
  return allocate(d, &needs, VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT,
                  &out->memory) &&
         vkBindBufferMemory(d->handle, out->buffer, out->memory, 0) == VK_SUCCESS &&
         vkMapMemory(d->handle, out->memory, 0, VK_WHOLE_SIZE, 0, &out->data) == VK_SUCCESS;
}

void vk_free_buffer(const vk_device *d, vk_buffer *b) {
  vkDestroyBuffer(d->handle, b->buffer, NULL);
  vkFreeMemory(d->handle, b->memory, NULL);
  *b = (vk_buffer){0};
}

/* ---- commands ---- */

bool vk_begin(const vk_device *d) {
  const VkCommandBufferBeginInfo info = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO,
                                         .flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT};
  return vkBeginCommandBuffer(d->command, &info) == VK_SUCCESS;
}

bool vk_finish(const vk_device *d) {
  const VkSubmitInfo info = {
      .sType = VK_STRUCTURE_TYPE_SUBMIT_INFO, .commandBufferCount = 1, .pCommandBuffers = &d->command};
  return vkEndCommandBuffer(d->command) == VK_SUCCESS &&
         vkQueueSubmit(d->queue, 1, &info, VK_NULL_HANDLE) == VK_SUCCESS &&
         vkQueueWaitIdle(d->queue) == VK_SUCCESS;
}

/* ---- textures ---- */

static void change_layout(const vk_device *d, VkImage image, VkImageLayout from, VkImageLayout to) {
  const bool filled = to == VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL;
  const VkImageMemoryBarrier barrier = {
      .sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER,
      .srcAccessMask = filled ? VK_ACCESS_TRANSFER_WRITE_BIT : 0,
      .dstAccessMask = filled ? VK_ACCESS_SHADER_READ_BIT : VK_ACCESS_TRANSFER_WRITE_BIT,
      .oldLayout = from,
      .newLayout = to,
      .srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
      .dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
      .image = image,
      .subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, VK_REMAINING_MIP_LEVELS, 0,
                           VK_REMAINING_ARRAY_LAYERS}};
  vkCmdPipelineBarrier(d->command,
                       filled ? VK_PIPELINE_STAGE_TRANSFER_BIT : VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT,
                       filled ? VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT : VK_PIPELINE_STAGE_TRANSFER_BIT, 0, 0,
                       NULL, 0, NULL, 1, &barrier);
}

static uint32_t halved(uint32_t size, uint32_t level) {
  return size >> level ? size >> level : 1;
}

/* Offsets of levels in the buffer are multiples of every texel's size. */
static VkDeviceSize aligned(uint64_t size) {
  return (size + 15) / 16 * 16;
}

static const char *fill_image(const vk_device *d, const folder_texture *t, VkImage image) {
  const uint32_t layers = t->dimension == BTF_TEXTURE_2D_ARRAY ? t->slices : 1;
  VkBufferImageCopy copies[KTX2_MOST_LEVELS];
  VkDeviceSize size = 0;
  vk_buffer staging = {0};
  for (uint32_t l = 0; l < t->file.levels; l++) {
    copies[l] =
        (VkBufferImageCopy){.bufferOffset = size,
                            .imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, l, 0, layers},
                            .imageExtent = {halved(t->file.width, l), halved(t->file.height, l),
                                            t->dimension == BTF_TEXTURE_3D ? halved(t->file.depth, l) : 1}};
    size += aligned(t->file.level_size[l]);
  }
  bool done = vk_make_buffer(d, size, VK_BUFFER_USAGE_TRANSFER_SRC_BIT, &staging) && vk_begin(d);
  if (done) {
    for (uint32_t l = 0; l < t->file.levels; l++)
      memcpy((char *)staging.data + copies[l].bufferOffset, t->file.level[l], t->file.level_size[l]);
    change_layout(d, image, VK_IMAGE_LAYOUT_UNDEFINED, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL);
    vkCmdCopyBufferToImage(d->command, staging.buffer, image, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL,
                           t->file.levels, copies);
    change_layout(d, image, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL);
    done = vk_finish(d);
  }
  vk_free_buffer(d, &staging);
  return done ? NULL : "Vulkan does not copy a texture";
}

static bool can_sample(const vk_device *d, const folder_texture *t) {
  VkFormatProperties properties;
  vkGetPhysicalDeviceFormatProperties(d->physical, (VkFormat)t->file.vk_format, &properties);
  const VkFormatFeatureFlags wanted = VK_FORMAT_FEATURE_SAMPLED_IMAGE_BIT |
                                      (t->filtered ? VK_FORMAT_FEATURE_SAMPLED_IMAGE_FILTER_LINEAR_BIT : 0);
  return (properties.optimalTilingFeatures & wanted) == wanted;
}

const char *vk_make_image(const vk_device *d, const folder_texture *t, vk_image *out) {
  const bool is_3d = t->dimension == BTF_TEXTURE_3D, is_array = t->dimension == BTF_TEXTURE_2D_ARRAY;
  const VkFormat format = (VkFormat)t->file.vk_format;
  const VkImageCreateInfo info = {.sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO,
                                  .imageType = is_3d ? VK_IMAGE_TYPE_3D : VK_IMAGE_TYPE_2D,
                                  .format = format,
                                  .extent = {t->file.width, t->file.height, is_3d ? t->slices : 1},
                                  .mipLevels = t->file.levels,
                                  .arrayLayers = is_array ? t->slices : 1,
                                  .samples = VK_SAMPLE_COUNT_1_BIT,
                                  .tiling = VK_IMAGE_TILING_OPTIMAL,
                                  .usage = VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT};
  const VkSamplerAddressMode wrap[2] = {VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE,
                                        VK_SAMPLER_ADDRESS_MODE_REPEAT};
  const VkFilter filter = t->filtered ? VK_FILTER_LINEAR : VK_FILTER_NEAREST;
  const VkSamplerCreateInfo sampler = {.sType = VK_STRUCTURE_TYPE_SAMPLER_CREATE_INFO,
                                       .magFilter = filter,
                                       .minFilter = filter,
                                       .mipmapMode = t->filtered ? VK_SAMPLER_MIPMAP_MODE_LINEAR
                                                                 : VK_SAMPLER_MIPMAP_MODE_NEAREST,
                                       .addressModeU = wrap[t->repeat[0]],
                                       .addressModeV = wrap[t->repeat[1]],
                                       .addressModeW = wrap[0],
                                       .maxLod = VK_LOD_CLAMP_NONE};
  VkMemoryRequirements needs;
  if (!can_sample(d, t)) return "the device does not sample a format";
  if (vkCreateImage(d->handle, &info, NULL, &out->image) != VK_SUCCESS) return "Vulkan refuses a texture";
  vkGetImageMemoryRequirements(d->handle, out->image, &needs);
  if (!allocate(d, &needs, 0, &out->memory) ||
      vkBindImageMemory(d->handle, out->image, out->memory, 0) != VK_SUCCESS)
    return "no memory for a texture";
  const VkImageViewCreateInfo view = {
      .sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO,
      .image = out->image,
      .viewType = is_3d      ? VK_IMAGE_VIEW_TYPE_3D
                  : is_array ? VK_IMAGE_VIEW_TYPE_2D_ARRAY
                             : VK_IMAGE_VIEW_TYPE_2D,
      .format = format,
      .subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, info.mipLevels, 0, info.arrayLayers}};
  if (vkCreateImageView(d->handle, &view, NULL, &out->view) != VK_SUCCESS ||
      vkCreateSampler(d->handle, &sampler, NULL, &out->sampler) != VK_SUCCESS)
    return "Vulkan has no view of a texture";
  return fill_image(d, t, out->image);
}

void vk_free_image(const vk_device *d, vk_image *i) {
  vkDestroySampler(d->handle, i->sampler, NULL);
  vkDestroyImageView(d->handle, i->view, NULL);
  vkDestroyImage(d->handle, i->image, NULL);
  vkFreeMemory(d->handle, i->memory, NULL);
  *i = (vk_image){0};
}

/* ---- the device ---- */

/* The first device; its first family of queues that computes. */
static bool choose_device(vk_device *d) {
  VkQueueFamilyProperties families[16];
  VkPhysicalDeviceProperties properties;
  uint32_t devices = 1, count = sizeof families / sizeof *families;
  const VkResult result = vkEnumeratePhysicalDevices(d->instance, &devices, &d->physical);
  if ((result != VK_SUCCESS && result != VK_INCOMPLETE) || devices == 0) return false;
  vkGetPhysicalDeviceProperties(d->physical, &properties);
  vkGetPhysicalDeviceMemoryProperties(d->physical, &d->memory);
  vkGetPhysicalDeviceQueueFamilyProperties(d->physical, &count, families);
  snprintf(d->name, sizeof d->name, "%s", properties.deviceName);
  for (d->family = 0; d->family < count; d->family++)
    if ((families[d->family].queueFlags & VK_QUEUE_COMPUTE_BIT) != 0) return true;
  return false;
}

static bool make_device(vk_device *d) {
  static const float priority = 1.0f;
  const VkDeviceQueueCreateInfo queue = {.sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO,
                                         .queueFamilyIndex = d->family,
                                         .queueCount = 1,
                                         .pQueuePriorities = &priority};
  const VkDeviceCreateInfo info = {
      .sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO, .queueCreateInfoCount = 1, .pQueueCreateInfos = &queue};
  if (vkCreateDevice(d->physical, &info, NULL, &d->handle) != VK_SUCCESS) return false;
  vkGetDeviceQueue(d->handle, d->family, 0, &d->queue);
  const VkCommandPoolCreateInfo pool = {.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO,
                                        .flags = VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT,
                                        .queueFamilyIndex = d->family};
  if (vkCreateCommandPool(d->handle, &pool, NULL, &d->commands) != VK_SUCCESS) return false;
  const VkCommandBufferAllocateInfo command = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
                                               .commandPool = d->commands,
                                               .level = VK_COMMAND_BUFFER_LEVEL_PRIMARY,
                                               .commandBufferCount = 1};
  return vkAllocateCommandBuffers(d->handle, &command, &d->command) == VK_SUCCESS;
}

const char *vk_open_device(vk_device *d) {
  const VkApplicationInfo application = {.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO,
                                         .apiVersion = VK_API_VERSION_1_0};
  const VkInstanceCreateInfo info = {.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO,
                                     .pApplicationInfo = &application};
  *d = (vk_device){0};
  if (vkCreateInstance(&info, NULL, &d->instance) != VK_SUCCESS) return "no Vulkan";
  if (!choose_device(d)) return "no Vulkan device that computes";
  return make_device(d) ? NULL : "the Vulkan device does not open";
}

void vk_close_device(vk_device *d) {
  if (d->handle != VK_NULL_HANDLE) {
    vkDestroyCommandPool(d->handle, d->commands, NULL);
    vkDestroyDevice(d->handle, NULL);
  }
  if (d->instance != VK_NULL_HANDLE) vkDestroyInstance(d->instance, NULL);
}
