#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Runs the examples one after the other on a small material. Usage: examples.sh EXAMPLES_DIR BTF
set -eu
examples=$1
btf=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
passed=0
failed=0
check() { # what, expected text, command...
  local what=$1 expected=$2
  shift 2
  if "$@" >"$work/output" 2>&1 && grep -qF -- "$expected" "$work/output"; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    echo "FAILED $what: expected \"$expected\" in"
    cat "$work/output"
  fi
}
check "a computed source is encoded" "saved" "$examples/example_source" "$work/source.btfz"
check "its model is evaluated" "fmf: 32 x 32 texels, 1 channels, 6 levels" "$examples/example_evaluate" "$work/source.btfz"
"$btf" synth lambert -o "$work/lambert.btfd" --size 4x4 --directions grid:6x3 --quiet
check "a folder is encoded" "" "$examples/example_encode" "$work/lambert.btfd" "$work/lambert.btfz" fmf components=2
# 0.8 / pi
check "and evaluates to its albedo" "f = 0.2546" "$examples/example_evaluate" "$work/lambert.btfz"
check "a folder is evaluated as it stands" "f = 0.2546" "$examples/example_evaluate" "$work/lambert.btfd"
if "$examples/example_encode" "$work/lambert.btfd" "$work/x.btfz" fmf components=0 >"$work/output" 2>&1; then
  failed=$((failed + 1))
  echo "FAILED: components=0 was accepted"
else
  passed=$((passed + 1))
fi
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
