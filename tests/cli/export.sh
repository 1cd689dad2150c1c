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
    run export export.btfz --list -o exported
    expect "export --list writes nothing" 1 "--list"
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
    run export export.btfz -o exported --viewer
    expect "export --viewer" 0 "open exported/index.html"
    grep -q '"page": "index.html"' exported/manifest.json && pass || fail "the manifest names the page"
    grep -o 'data-file="btf.glsl">[^<]*' exported/index.html | sed 's/.*>//' | base64 -d | cmp -s - exported/btf.glsl && pass ||
      fail "the page holds the shader"
    grep -o 'data-file="btf_v_map.ktx2">[^<]*' exported/index.html | sed 's/.*>//' | base64 -d | cmp -s - exported/btf_v_map.ktx2 && pass ||
      fail "the page holds the textures"
    grep -qE '^import |<link rel="stylesheet"|src="src/' exported/index.html && fail "the page needs other files" || pass
    run export export.btfz -o exported --quiet
    [ ! -e exported/index.html ] && pass || fail "the page of an earlier export goes with it"
    run export export.btfz -o packed --compress zip
    expect "an unknown compression" 1 "--compress takes bc"
    run export export.btfz -o packed --layout rgba --compress bc
    expect "export --compress" 0 "btf_v_map"
    run encode export.btfd -o cmf.btfz --codec cmf -p edge=16 --quiet
    if [ "$status" = 0 ]; then
      run export cmf.btfz -o packed --compress bc
      expect "blocks and what they cost" 0 "BC7"
      grep -q '"vk_format": 145' packed/manifest.json && grep -q '"psnr_db"' packed/manifest.json && pass ||
        fail "the manifest says what is compressed" "$(cat packed/manifest.json)"
    fi
    mkdir other && touch other/manifest.json
    run export export.btfz -o other
    expect "a folder of somebody else" 2 "not a GPU export"
    run export export.btfz -o x --layout nonesuch
    expect "an unknown layout" 1 "nonesuch"
    run export export.btfz -o x --max-textures 1
    expect "too few textures" 6 "textures"
    run export export.btfz -o x --max-size 16 --max-layers 1 --max-textures 64
    expect "pages for layers" 6 "along a side"
    run export export.btfz -o paged --max-layers 1
    expect "pages" 0 "btf_u_map2"
    [ ! -e x ] && pass || fail "a failed export left something behind"
  fi
  run export export.btfd -o x
  expect "export of a data set" 5 "exports nothing"
fi
