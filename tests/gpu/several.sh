#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Two exports in one program, as docs/gpu-export.md says: prefixes replaced, bindings moved. An export of every codec stands
# beside one of FMF, in GLSL ES 3.00, GLSL 3.30 and GLSL 4.50 for Vulkan. Usage: several.sh BTF. Ends with 77 where
# glslangValidator, spirv-dis or FMF is missing.
set -u
btf=$1
. "${BASH_SOURCE%/*}/shader_checks.sh" glslangValidator spirv-dis

# export_model NAME CODEC MATERIAL: the shader as NAME.glsl
export_model() {
  "$btf" encode "$work/$3.btfd" -o "$work/$1.btfz" --codec "$2" --quiet >/dev/null 2>&1 &&
    "$btf" export "$work/$1.btfz" -o "$work/$1" --quiet && cp "$work/$1/btf.glsl" "$work/$1.glsl"
}

renamed() { # FILE PREFIX
  sed "s/btf_/$2_/g; s/BTF_/${2^^}_/g" "$1"
}

# program HEAD DEFINES SECOND FUNCTION: the first material, what moves bindings, the second, and a shader that calls both.
program() {
  printf '%b' "$1"
  renamed "$work/wool.glsl" wool
  printf '%b' "$2"
  cat "$3"
  printf 'layout(location = 0) out vec4 result;\n'
  printf 'void main() { vec3 d = vec3(0.6, 0.0, 0.8); result = vec4(wool_eval(d, d, d.xy, 0.0) + %s(d, d, d.xy, 0.0), 1.0); }\n' "$4"
}

# unique FILE: no two variables of a descriptor set have one binding.
unique() {
  spirv-dis "$1" | grep -o 'Decorate %[a-z_0-9]* Binding [0-9]*' | sed 's/.* //' | sort -n | uniq -d >"$work/twice"
  [ -s "$1" ] && [ ! -s "$work/twice" ]
}

# Of other sizes and directions, and the same codec and settings.
"$btf" synth bumps -o "$work/first.btfd" --size 16x16 --directions grid:4x2 --spp 1 --quiet || { echo "skipped: no materials"; exit 77; }
"$btf" synth rings -o "$work/second.btfd" --size 24x24 --directions grid:5x2 --spp 1 --quiet
export_model wool fmf first || { echo "skipped: no FMF"; exit 77; }
es='#version 300 es\nprecision highp float;\n'
for codec in $("$btf" codecs --json | grep -o '"id": *"[a-z]*"' | cut -d'"' -f4); do
  check "$codec: export" export_model silk "$codec" second || continue
  renamed "$work/silk.glsl" silk >"$work/renamed.glsl"
  program "$es" '' "$work/renamed.glsl" silk_eval >"$work/es.frag"
  program '#version 330\n' '' "$work/renamed.glsl" silk_eval >"$work/gl.frag"
  check "$codec: GLSL ES 3.00 and GLSL 3.30" glslangValidator "$work/es.frag" "$work/gl.frag"
  program '#version 450\n' '#define SILK_BINDING(n) layout(binding = n + 8)\n#define SILK_BLOCK(n) layout(std140, binding = n + 8)\n' \
    "$work/renamed.glsl" silk_eval >"$work/vulkan.frag"
  check "$codec: GLSL 4.50, Vulkan" glslangValidator -V "$work/vulkan.frag" -o "$work/vulkan.spv" &&
    check "$codec: no binding twice" unique "$work/vulkan.spv"
  program '#version 450\n' '#define SILK_BINDING(n) layout(set = 1, binding = n)\n#define SILK_BLOCK(n) layout(std140, set = 1, binding = n)\n' \
    "$work/renamed.glsl" silk_eval >"$work/vulkan.frag"
  check "$codec: another descriptor set" glslangValidator -V "$work/vulkan.frag" -o "$work/vulkan.spv"
done
# What the checks above can see: names left as they are, and bindings.
renamed "$work/wool.glsl" wool >"$work/again.glsl"
program "$es" '' "$work/again.glsl" wool_eval >"$work/same.frag"
check "one prefix for two is refused" eval '! glslangValidator "$work/same.frag"'
program '#version 450\n' '' "$work/renamed.glsl" silk_eval >"$work/vulkan.frag"
glslangValidator -V "$work/vulkan.frag" -o "$work/vulkan.spv" >/dev/null
check "bindings that meet are noticed" eval '! unique "$work/vulkan.spv"'
check "another material of the same codec" export_model other fmf second &&
  check "has the same text" cmp "$work/wool.glsl" "$work/other.glsl"
finish
