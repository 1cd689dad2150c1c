/* SPDX-License-Identifier: MIT */
/* vk_device.h: the first device of Vulkan, with one command buffer, and its buffers and textures. What failed
 * half-way is freed like what was made. */
#ifndef VK_DEVICE_H
#define VK_DEVICE_H

#include <vulkan/vulkan.h>

#include "gpu_folder.h"

typedef struct vk_device {
  VkInstance instance;
  VkPhysicalDevice physical;
  VkPhysicalDeviceMemoryProperties memory;
  VkDevice handle;
  uint32_t family;
  VkQueue queue;
  VkCommandPool commands;
  VkCommandBuffer command;
  char name[VK_MAX_PHYSICAL_DEVICE_NAME_SIZE];
} vk_device;

/* NULL when open, otherwise what is missing; to be closed in either case. */
const char *vk_open_device(vk_device *d);
void vk_close_device(vk_device *d);

/* Begins the command buffer; submits it and waits. */
bool vk_begin(const vk_device *d);
bool vk_finish(const vk_device *d);

/* Memory that both sides see. */
typedef struct vk_buffer {
  VkBuffer buffer;
  VkDeviceMemory memory;
  void *data;
} vk_buffer;
bool vk_make_buffer(const vk_device *d, VkDeviceSize size, VkBufferUsageFlags usage, vk_buffer *out);
void vk_free_buffer(const vk_device *d, vk_buffer *b);

typedef struct vk_image {
  VkImage image;
  VkDeviceMemory memory;
  VkImageView view;
  VkSampler sampler;
} vk_image;
/* NULL when the texture is filled, otherwise what is wrong. */
const char *vk_make_image(const vk_device *d, const folder_texture *t, vk_image *out);
void vk_free_image(const vk_device *d, vk_image *i);

#endif
