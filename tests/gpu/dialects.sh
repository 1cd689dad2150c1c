#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Compiles the shaders of exports with the reference compiler as GLSL ES 3.00, GLSL 3.30 and GLSL 4.50 for Vulkan, and turns
# the latter into HLSL and MSL. Usage: dialects.sh BTF. Ends with 77 where glslangValidator or spirv-cross is missing.
set -u
btf=$1
for tool in glslangValidator spirv-cross; do
  command -v "$tool" >/dev/null || { echo "skipped: no $tool"; exit 77; }
done
work=$(mktemp -d "${TMPDIR:-/tmp}/btf-glsl-XXXXXX")
trap 'rm -rf "$work"' EXIT
passed=0
failed=0

# check NAME COMMAND...: the command must succeed and say nothing of warnings.
check() {
  local name=$1
  shift
  if "$@" >"$work/out.txt" 2>&1 && ! grep -qi warning "$work/out.txt"; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    echo "FAILED: $name"
    head -5 "$work/out.txt"
  fi
}

# shader VERSION-LINES FOLDER FILE
shader() {
  {
    printf '%b' "$1"
    cat "$2/btf.glsl"
    printf 'layout(location = 0) in vec3 at;\nlayout(location = 0) out vec4 result;\n'
    printf 'void main() { result = vec4(btf_eval(at, at.zxy, at.xy, at.z), 1.0); }\n'
  } >"$3"
}

"$btf" synth bumps -o "$work/m.btfd" --size 8x8 --directions grid:4x2 --spp 1 --quiet || { echo "skipped: no materials"; exit 77; }
for codec in $("$btf" codecs --json | grep -o '"id": *"[a-z]*"' | cut -d'"' -f4); do
  if ! "$btf" encode "$work/m.btfd" -o "$work/$codec.btfz" --codec "$codec" --quiet >"$work/out.txt" 2>&1; then
    failed=$((failed + 1))
    echo "FAILED: $codec: encode"
    head -5 "$work/out.txt"
    continue
  fi
  for layout in $("$btf" export "$work/$codec.btfz" --list | awk '{ print $1 }'); do
    folder=$work/$codec-$layout
    check "$codec $layout: export" "$btf" export "$work/$codec.btfz" -o "$folder" --layout "$layout" --quiet
    shader '#version 300 es\nprecision highp float;\n' "$folder" "$work/es.frag"
    sed -i 's/^layout(location = 0) in vec3 at/in vec3 at/' "$work/es.frag"
    check "$codec $layout: GLSL ES 3.00" glslangValidator "$work/es.frag"
    shader '#version 330\n' "$folder" "$work/gl.frag"
    sed -i 's/^layout(location = 0) in vec3 at/in vec3 at/' "$work/gl.frag"
    check "$codec $layout: GLSL 3.30" glslangValidator "$work/gl.frag"
    shader '#version 450\n' "$folder" "$work/vulkan.frag"
    check "$codec $layout: GLSL 4.50, Vulkan" glslangValidator -V "$work/vulkan.frag" -o "$work/vulkan.spv"
    check "$codec $layout: HLSL" spirv-cross "$work/vulkan.spv" --hlsl --shader-model 50 --output "$work/m.hlsl"
    check "$codec $layout: MSL" spirv-cross "$work/vulkan.spv" --msl --output "$work/m.metal"
  done
done
echo "$passed passed, $failed failed"
[ "$failed" = 0 ] && [ "$passed" -gt 0 ]
