# SPDX-License-Identifier: MIT
# GPU exports: the folder, its manifest, limits, what is replaced and what is not.

run synth lambert -o export.btfd --size 8x4 --directions grid:4x2 --quiet
if [ "$status" != 0 ]; then
  skip "export: no materials in this build"
else
  run encode export.btfd -o export.btfz --codec fmf -p components=2 --quiet
  if [ "$status" != 0 ]; then
    skip "export: no fmf"
  else
    run export export.btfz --list
    expect "export --list" 0 "(default)"
    cut -d' ' -f1 out.txt >names.txt
    run export export.btfz --list --json
    expect_json "export --list --json"
    sed -n 's/.*"name": "\(.*\)",/\1/p' out.txt | cmp -s - names.txt && pass || fail "export --list --json has the names" "$out"
    for option in "--output exported" "--layout rgba" --viewer "--compress bc" "--zstd 3" "--max-size 64" "--max-3d 64" \
      "--max-layers 8" "--max-textures 8"; do
      run export export.btfz --list $option
      expect "export --list with $option" 1 "takes no ${option% *}"
    done
    run export export.btfz
    expect "export without -o" 1 "--output"
    for option in "--max-size 15" "--max-3d 15" "--max-layers 0" "--max-textures 65" "--zstd 23"; do
      run export export.btfz -o exported $option
      expect "export $option" 1 "${option% *}"
    done
    [ ! -e exported ] && pass || fail "a command line that is wrong writes nothing"
    run export export.btfz -o exported
    expect "export" 0 "btf_u_map"
    [ "$(ls exported | sort | tr '\n' ' ')" = "btf.glsl btf_light_facet_map.ktx2 btf_light_near_map.ktx2 btf_u_map.ktx2 btf_v_map.ktx2 manifest.json " ] &&
      pass || fail "files of an export" "$(ls exported)"
    run export export.btfz -o exported --json
    expect_json "export --json"
    cmp -s out.txt exported/manifest.json && pass || fail "export --json prints the manifest"
    touch exported/notes.txt
    run export export.btfz -o exported --zstd 3 --quiet
    expect "an earlier export is replaced" 0
    [ -e exported/notes.txt ] && pass || fail "what lay beside an export is kept"
    [ "$(leftovers . exported export.btfd | grep -c exported)" = 0 ] && pass || fail "an export left something behind" "$(ls -A)"
    echo mine >exported/index.html
    run export export.btfz -o exported --quiet
    [ "$(cat exported/index.html)" = mine ] && pass || fail "a page of somebody else is kept"
    rm exported/index.html
    run export export.btfz -o exported// --viewer
    expect "export --viewer" 0 "open exported/index.html in"
    run export export.btfz -o exported --viewer --json
    expect_json "export --viewer --json"
    cmp -s out.txt exported/manifest.json && grep -q '"page": "index.html"' out.txt && pass ||
      fail "export --viewer --json prints the manifest with the page" "${out:0:200}"
    grep -o 'data-file="btf.glsl">[^<]*' exported/index.html | sed 's/.*>//' | base64 -d | cmp -s - exported/btf.glsl && pass ||
      fail "the page holds the shader"
    grep -o 'data-file="btf_v_map.ktx2">[^<]*' exported/index.html | sed 's/.*>//' | base64 -d | cmp -s - exported/btf_v_map.ktx2 && pass ||
      fail "the page holds the textures"
    grep -qE '^import |<link rel="stylesheet"|src="src/' exported/index.html && fail "the page needs other files" || pass
    run export export.btfz -o exported --quiet
    [ ! -e exported/index.html ] && pass || fail "the page of an earlier export goes with it"
    run export export.btfz --compress -o packed
    expect "--compress without its value" 1 '--compress needs a value (bc), not "-o"'
    run export export.btfz -o packed --compress zip
    expect "an unknown compression" 1 "--compress takes bc"
    run export export.btfz -o packed --layout rgba --compress bc
    expect "export --compress" 0 "btf_v_map"
    # A factor that is the same in all texels keeps every bit.
    grep -q "BC7 without loss" out.txt && grep -q "^blocks save .* without loss" out.txt && pass || fail "blocks that lose nothing" "$out"
    run encode export.btfd -o lobes.btfz --codec lafortune --quiet
    if [ "$status" = 0 ]; then
      run export lobes.btfz -o packed --compress bc
      expect "nothing to compress" 0 "btf_lobes_map"
      grep -q "all stay as they are" err.txt && pass || fail "a note says that nothing is compressed" "$err"
    fi
    run encode export.btfd -o cmf.btfz --codec cmf -p edge=16 --quiet
    if [ "$status" = 0 ]; then
      run export cmf.btfz -o packed --compress bc
      expect "blocks and what they cost" 0 "BC7"
      grep -q '"vk_format": 145' packed/manifest.json && grep -q '"psnr_db"' packed/manifest.json && pass ||
        fail "the manifest says what is compressed" "$(cat packed/manifest.json)"
    fi
    run info exported
    expect "an export where data are wanted" 3 "exported/manifest.json: is that of a GPU export; give the .btfz"
    mkdir other && touch other/manifest.json
    run export export.btfz -o other
    expect "a folder of somebody else" 2 "not a GPU export"
    run export export.btfz -o x --layout nonesuch
    expect "an unknown layout" 1 "nonesuch"
    run export export.btfz -o x --max-textures 1
    expect "too few textures" 6 "4 textures, more than the target's 1; a target of at least 4 would do"
    run export export.btfz -o x --max-size 100
    expect "a map of one size" 6 "2D textures; a target of at least 256 would do"
    run export export.btfz -o x --max-size 16 --max-layers 1 --max-textures 64
    expect "pages for layers" 6 "along a side"
    run export export.btfz -o paged --max-layers 1
    expect "pages" 0 "btf_u_map2"
    run synth bumps -o bumps.btfd --size 8x8 --directions grid:4x2 --spp 1 --quiet
    run encode bumps.btfd -o bumps.btfz --codec fmf -p components=16 --quiet
    # 3 channels of 4 textures by directions, 4 of the material, 2 of the triangulation.
    run export bumps.btfz -o paged --max-layers 1 --max-textures 18 --viewer
    expect "more textures than every browser takes" 0 "open paged/index.html"
    grep -q "a browser that takes 18 textures" err.txt && pass || fail "a note says how many textures the page needs" "$err"
    run export bumps.btfz -o paged --viewer
    [ "$status" = 0 ] && [ -z "$err" ] && pass || fail "no note where every browser will do" "$err"
    run export bumps.btfz -o paged --compress bc
    expect "blocks that lose something" 0 "BC7 at "
    grep -q "^blocks save .* texels are kept at [0-9.]* dB$" out.txt && pass || fail "what all blocks cost" "$out"
    [ ! -e x ] && pass || fail "a failed export left something behind"
  fi
  run export export.btfd -o x
  expect "export of a data set" 5 "exports nothing"
  run export export.btfd --list
  expect "layouts of a data set" 5 "exports nothing"
fi
