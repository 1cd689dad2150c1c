/* SPDX-License-Identifier: MIT */
/* Every rule on every row of codec_cases.c: `test_codecs [CODEC...]`, without names all codecs of the build.
 */
#include "codec_rules.h"

typedef struct check {
  const codec_rule *rule;
  const codec_case *row;
} check;

static void run_check(void **state) {
  const check *c = *state;
  c->rule->check(c->row);
}

/* What the program was asked for, and those of them that are in the build. */
static const char *const *asked;
static size_t asked_count;

static int is_asked(const char *codec) {
  for (size_t i = 0; i < asked_count; i++)
    if (strcmp(asked[i], codec) == 0) return 1;
  return asked_count == 0;
}

static void every_codec_has_a_row(void **state) {
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 1);
  (void)state;
  for (uint32_t i = 0; i < btf_codec_count(ctx); i++) {
    const char *id = btf_codec_id(btf_codec_at(ctx, i));
    size_t rows = 0, faults = 0;
    for (size_t k = 0; k < codec_case_count; k++)
      if (strcmp(codec_cases[k].codec, id) == 0) {
        rows++;
        faults += codec_cases[k].faults;
      }
    if (rows == 0) fail_msg("the codec %s has no row in tests/codec_cases.c", id);
    if (faults == 0) fail_msg("no row of the codec %s in tests/codec_cases.c has .faults", id);
  }
  for (size_t i = 0; i < asked_count; i++)
    if (btf_codec_find(ctx, asked[i]) == NULL) fail_msg("the codec %s is not in this build", asked[i]);
  test_context_done(ctx, &memory);
}

static int in_build(const char *codec) {
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  if (codec_case_context(&desc, &ctx) != BTF_OK) return 0;
  const btf_codec *found = btf_codec_find(ctx, codec);
  const int usable = found != NULL && (btf_codec_caps(found) & BTF_CAP_FIT) != 0;
  btf_context_release(ctx);
  return usable;
}

static size_t add_rules(struct CMUnitTest *tests, check *checks, size_t n, const codec_case *row,
                        const codec_rule *rules, size_t count) {
  for (size_t i = 0; i < count; i++, n++) {
    char *name = malloc(256);
    if (name == NULL) abort();
    snprintf(name, 256, "%s %s: %s", row->codec, row->options, rules[i].name);
    checks[n] = (check){&rules[i], row};
    tests[n] = (struct CMUnitTest){name, run_check, NULL, NULL, &checks[n]};
  }
  return n;
}

int main(int argc, char **argv) {
  const size_t most = 1 + codec_case_count * (codec_eval_rule_count + codec_fit_rule_count);
  struct CMUnitTest *tests = calloc(most, sizeof *tests);
  check *checks = calloc(most, sizeof *checks);
  size_t n = 1;
  if (tests == NULL || checks == NULL) return 1;
  asked = (const char *const *)argv + 1;
  asked_count = (size_t)argc - 1;
  tests[0] = (struct CMUnitTest){"every_codec_has_a_row", every_codec_has_a_row, NULL, NULL, NULL};
  for (size_t i = 0; i < codec_case_count; i++) {
    const codec_case *row = &codec_cases[i];
    if (!is_asked(row->codec)) continue;
    if (!in_build(row->codec)) {
      print_message("%s is not in this build: its row is passed over\n", row->codec);
      continue;
    }
    n = add_rules(tests, checks, n, row, codec_eval_rules, codec_eval_rule_count);
    n = add_rules(tests, checks, n, row, codec_fit_rules, codec_fit_rule_count);
  }
  const int result = btf_run_group("codecs", tests, n);
  for (size_t i = 1; i < n; i++) free((void *)(uintptr_t)tests[i].name);
  free(tests);
  free(checks);
  return result;
}
