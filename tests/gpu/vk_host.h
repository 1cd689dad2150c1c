/* SPDX-License-Identifier: MIT */
/* vk_host.h: a renderer that evaluates queries in a compute shader of Vulkan, software or not. */
#ifndef VK_HOST_H
#define VK_HOST_H

#include "gpu_folder.h"

/* NULL where there is no device; *why says what is missing. */
gpu_host *vk_host_open(const char **why);

#endif
