#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Runs the examples one after the other on a small material. Usage: examples.sh EXAMPLES_DIR BTF [PICTURE_DIFFERENCE]
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
refuse() { # the same of a command that must fail
  local what=$1 expected=$2
  shift 2
  if ! "$@" >"$work/output" 2>&1 && grep -qF -- "$expected" "$work/output"; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    echo "FAILED $what: expected a failure with \"$expected\" in"
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
refuse "components=0 is accepted" "components" "$examples/example_encode" "$work/lambert.btfd" "$work/x.btfz" fmf components=0

# A picture of software GL against that of the C evaluation: same camera, light and tiles, one sample a pixel. Most pixels
# differ by the rounding to 8 bits alone, those along the silhouette and the pole by more: less than 1 in the mean.
draw_sphere() {
  local host=$examples/gl_host/example_gl_host difference=$1
  "$btf" synth bumps -o "$work/bumps.btfd" --size 16x16 --directions grid:6x3 --spp 1 --quiet
  "$btf" encode "$work/bumps.btfd" -o "$work/bumps.btfz" --codec fmf --quiet >/dev/null
  if ! "$host" "$work/bumps.btfz" "$work/drawn.png" >"$work/output" 2>&1 && grep -q "^EGL has no" "$work/output"; then
    echo "skipped gl_host: $(cat "$work/output")"
    return
  fi
  check "a model is drawn by OpenGL" "saved" "$host" "$work/bumps.btfz" "$work/drawn.png"
  refuse "a picture where no folder is" "$work/none/drawn.png: " "$host" "$work/bumps.btfz" "$work/none/drawn.png"
  refuse "a data set is drawn" "bumps.btfd: a data set exports nothing; btf encode" "$host" "$work/bumps.btfd" "$work/drawn.png"
  "$btf" export "$work/bumps.btfz" -o "$work/exported" --quiet
  refuse "an export is drawn" "exported/manifest.json: is that of a GPU export" "$host" "$work/exported" "$work/drawn.png"
  check "--help" "usage: example_gl_host MODEL.btfz" "$host" --help
  "$btf" render "$work/bumps.btfz" -o "$work/rendered.png" --spp 1 --quiet
  "$btf" render "$work/bumps.btfz" -o "$work/other_light.png" --spp 1 --light -50,50 --quiet
  check "the picture is that of btf render" "mean difference 0." "$difference" "$work/drawn.png" "$work/rendered.png" 1
  refuse "another light is not noticed" "mean difference" "$difference" "$work/drawn.png" "$work/other_light.png" 1
}
if [ $# -gt 2 ]; then
  draw_sphere "$3"
else
  echo "skipped gl_host: it was not built, or btf has no render"
fi
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
