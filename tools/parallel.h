/* SPDX-License-Identifier: MIT */
/* parallel.h: loops over independent tasks in the tool's own threads. */
#ifndef BTF_TOOLS_PARALLEL_H
#define BTF_TOOLS_PARALLEL_H

#include <stdbool.h>
#include <stdint.h>

/* Task `index` on thread `thread` (0 .. threads - 1); false = stop the loop. */
typedef bool (*parallel_task_fn)(void *user, uint64_t index, uint32_t thread);

/* Runs tasks 0 .. count - 1. Thread t runs tasks t, t + threads, ... in order, so that sums kept per thread
 * are the same in every run; thread 0 is the caller's. Fewer threads run if the system gives no more. False
 * if a task stopped it. */
bool parallel_for(uint32_t threads, uint64_t count, parallel_task_fn task, void *user);

#endif
