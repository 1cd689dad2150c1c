#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Compiles the shaders of exports with the reference compiler as GLSL ES 3.00, GLSL 3.30 and GLSL 4.50 for Vulkan, and turns
# the latter into HLSL and MSL: of every codec and layout, with its defaults and with what makes its shader another one;
# defaults and storages in blocks and in pages, too. Usage: dialects.sh BTF. Ends with 77 where glslangValidator or
# spirv-cross is missing.
set -u
btf=$1
. "${BASH_SOURCE%/*}/shader_checks.sh" glslangValidator spirv-cross
shaders=0

# Material, codec and parameters. More than 256 clusters or entries are numbered by two bytes.
variants() {
  cat <<'END'
rgb fmf storage=f32 mean=true
rgb fmf storage=bf16
rgb fmf storage=q8
rgb fmf components=1 levels=1
rgb lafortune lobes=4 storage=f32
rgb lafortune kind=full
rgb lafortune kind=full color=channel lobes=1
rgb lafortune kind=phong
rgb lafortune kind=blinn_phong color=channel
rgb lafortune kind=ward
rgb lafortune kind=ward color=channel
rgb lafortune kind=lewis
rgb cmf codebook=0
rgb cmf codebook=300 storage=f16
rgb cmf codebook=8 storage=f32 rotate=true
rgb cmf codebook=0 rotate=true
rgb cmf codebook=8 map=cube residue=ratio
rgb cmf codebook=8 factors=4
rgb cmf codebook=8 chain=hd:2,io
rgb pvpca storage=f32 mean=false
rgb pvpca storage=q8 color=texels
rgb pvpca budget=adaptive
rgb lpca storage=f32 packing=tight
rgb lpca storage=q8 clusters=1 components=5
rgb lpca psnr=35
rgb lpca clusters=300 components=2
rgb laplacian storage=f32 mean=table
rgb laplacian filter=paper
rgb laplacian filter=binomial levels=1
rgb laplacian y=3 cb=0 cr=1 filter=paper mean=table
END
  for codec in $codecs; do
    echo "rgb $codec"
    [ "$codec" = laplacian ] || echo "grey $codec" # that takes three channels only
  done
  for material in two four; do
    printf "$material %s\n" fmf lafortune 'lafortune color=channel' 'pvpca color=texels'
  done
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

# compile NAME FOLDER: once for each text.
compile() {
  local name=$1 folder=$2 sum
  sum=$(cksum <"$folder/btf.glsl")
  grep -qxF "$sum" "$work/compiled" && return
  echo "$sum" >>"$work/compiled"
  shaders=$((shaders + 1))
  grep -o 'btf_range\|_map1' "$folder/btf.glsl" >>"$work/met"
  shader '#version 300 es\nprecision highp float;\n' "$folder" "$work/es.frag"
  shader '#version 330\n' "$folder" "$work/gl.frag"
  sed -i 's/^layout(location = 0) in vec3 at/in vec3 at/' "$work/es.frag" "$work/gl.frag"
  check "$name: GLSL ES 3.00 and GLSL 3.30" glslangValidator "$work/es.frag" "$work/gl.frag"
  shader '#version 450\n' "$folder" "$work/vulkan.frag"
  check "$name: GLSL 4.50, Vulkan" glslangValidator -V "$work/vulkan.frag" -o "$work/vulkan.spv" || return
  check "$name: HLSL" spirv-cross "$work/vulkan.spv" --hlsl --shader-model 50 --output "$work/m.hlsl"
  check "$name: MSL" spirv-cross "$work/vulkan.spv" --msl --output "$work/m.metal"
}

# reinterpret NAME WIDTH CHANNELS: the samples of rgb as those of a material of other channels, with the cosine and clamped.
reinterpret() {
  cp -r "$work/rgb.btfd" "$work/$1.btfd"
  sed -i "s/\"width\": 20/\"width\": $2/; s/\"channels\": .*\],/\"channels\": [$3],/; s/\"brdf\"/\"brdf_cos\"/
    s/\"samples\":/\"wrap\": \"clamp\", &/" "$work/$1.btfd/manifest.json"
}

"$btf" synth bumps -o "$work/rgb.btfd" --size 20x20 --directions grid:4x2 --spp 1 --quiet || { echo "skipped: no materials"; exit 77; }
reinterpret grey 60 '"Y"'
reinterpret two 30 '"Y", "Z"'
reinterpret four 15 '"R", "G", "B", "N"'
touch "$work/compiled"
codecs=$("$btf" codecs --json | grep -o '"id": *"[a-z]*"' | cut -d'"' -f4)
while read -r material codec parameters; do
  grep -qx "$codec" <<<"$codecs" || continue
  name="$codec $parameters, $material"
  options=()
  for parameter in $parameters; do options+=(-p "$parameter"); done
  case $codec in
  cmf) options+=(-p edge=8 -p resolution=4) ;;     # small
  lafortune) options+=(-p advise=1000) ;; # without a warning that it suits the material little
  esac
  check "$name: encode" "$btf" encode "$work/$material.btfd" -o "$work/m.btfz" --codec "$codec" --quiet "${options[@]}" || continue
  check "$name: layouts" "$btf" export "$work/m.btfz" --list || continue
  kinds=("")
  case "$material $parameters" in
  "rgb " | rgb*storage=*) kinds+=("--compress bc" "--max-layers 4 --max-textures 64") ;;
  esac
  cut -d' ' -f1 "$work/out.txt" >"$work/layouts"
  while read -r layout; do
    for kind in "${kinds[@]}"; do
      # shellcheck disable=SC2086
      check "$name, $layout $kind: export" "$btf" export "$work/m.btfz" -o "$work/export" --layout "$layout" $kind --quiet &&
        compile "$name, $layout $kind" "$work/export"
    done
  done <"$work/layouts"
done < <(variants)
check "there were blocks and pages" test "$(sort -u "$work/met" | wc -l)" = 2
echo "$shaders shaders"
finish
