/* SPDX-License-Identifier: MIT */
/*
 * Exports of every codec, evaluated by Vulkan from their folders alone and compared with the C evaluation:
 * textures by the VkFormat that the manifest states, the shader as SPIR-V with the descriptor set of the
 * host.
 */
#include "trial.h"
#include "vk_host.h"

static gpu_host *host;

static btf_context *make_context(void) {
  const btf_context_desc defaults = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  assert_ok(codec_case_context(&defaults, &ctx));
  return ctx;
}

static void every_codec(void **state) {
  btf_context *ctx = make_context();
  (void)state;
  trial_first_rows(host, ctx, TRIAL_RANDOM);
  trial_first_rows(host, ctx, TRIAL_PICTURE);
  btf_context_release(ctx);
}

static void faults_are_noticed(void **state) {
  btf_context *ctx = make_context();
  (void)state;
  for (size_t i = 0; i < TRIAL_FIRST_FAULTS; i++) trial_plant(host, ctx, &trial_faults[i]);
  btf_context_release(ctx);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(every_codec), cmocka_unit_test(faults_are_noticed)};
  const char *why;
  host = vk_host_open(&why);
  if (host == NULL) {
    printf("skipped: %s\n", why);
    return 77;
  }
  printf("%s\n", host->name);
  const int failed = btf_run("vulkan", tests);
  host->close(host);
  return failed;
}
