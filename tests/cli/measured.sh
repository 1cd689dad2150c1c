# SPDX-License-Identifier: MIT
# Measured data: recognised by content, imported, and taken by the other commands as it is.

run import --list
expect "import --list" 0 "folder: "
cp out.txt formats.txt
if ! grep -q '^bonn-btf:' out.txt; then
  skip "measured data: this build has no readers"
elif ! command -v python3 >/dev/null; then
  skip "measured data: no python3"
else
  # A factored file of 2 x 3 texels, 4 lights and 3 views: value = (light + 1) * (view + 1) * (10 y + x + 1) / 256, the file's
  # top row first.
  python3 - <<'END'
import math, struct
u32 = lambda *v: struct.pack('<%dI' % len(v), *v)
f32 = lambda *v: struct.pack('<%df' % len(v), *v)
out = b'!FMF06FC' + u32(264, 1) + b'dome'.ljust(240, b'\0') + f32(5, 1, 1, 1) + u32(3)
for v in range(3):
    out += f32(0.2 + 0.3 * v, v) + u32(4)
    for l in range(4):
        out += f32(0.1 + 0.3 * l, -l)
out += u32(2, 3, 1) + bytes([4]) + u32(1, 3 * 4 * 3, 6) + f32(1)
out += b''.join(f32((l + 1) * (v + 1)) for v in range(3) for l in range(4) for c in range(3))
out += b''.join(f32((10 * (2 - row) + x + 1) / 256) for row in range(3) for x in range(2))
open('measured.jpg', 'wb').write(out)
open('short.jpg', 'wb').write(out[:-1])
END
  run info measured.jpg
  expect "info of measured data" 0 "Bonn .btf"
  run info measured.jpg --json
  expect_json "info --json of measured data"
  printf '0 0 0 0\n1 2 3 2\n' >places.txt
  run fetch measured.jpg <places.txt
  expect "fetch of measured data" 0 "0.00390625 0.00390625 0.00390625
1.03125 1.03125 1.03125"
  run import measured.jpg -o imported.btfd --type f32
  expect "import tells what it wrote" 0 "imported.btfd: f32, "
  run compare measured.jpg imported.btfd --json
  expect "what is imported is what was there" 0 '"rmse": 0'
  grep -q '"bonn_setup": *"dome"' imported.btfd/manifest.json && pass || fail "what the reader found is in the manifest"
  run import measured.jpg -o cosine.btfd -p cosine=inside
  run info cosine.btfd
  expect "a parameter of a format" 0 "brdf_cos"
  run import measured.jpg -o x.btfd -p sine=inside
  expect "an unknown parameter of a format" 1 "sine"
  run import measured.jpg -o x.btfd --format folder
  expect "the wrong format" 3 "folder"
  run import measured.jpg -o x.btfd --format bonn-bft
  expect "a misspelt format" 1 "bonn-btf"
  run info measured.jpg --input cosine=inside
  expect "--input of another command" 0 "brdf_cos"
  run info measured.jpg --input sine=inside
  expect "--input of an unknown parameter" 1 "sine"
  run info measured.jpg --input cosine
  expect "--input without a value" 1 "--input is \"cosine\""
  run info measured.jpg --format bonn-bft
  expect "--format of another command" 1 "bonn-btf"
  run info measured.jpg --format bonn-btf
  expect "--format of another command" 0 "Bonn .btf"
  for option in "--allow-missing" "--transfer srgb"; do
    for command in "import" "encode --codec fmf"; do
      # shellcheck disable=SC2086
      run $command measured.jpg -o x.out $option
      expect "$command $option of a format without it" 1 "${option%% *}: the format bonn-btf has no parameter"
    done
  done
  run info imported.btfd --input cosine=inside
  expect "--input of a data set" 1 "cosine"
  for command in verify check "render -o measured.png"; do
    if [ "${command%% *}" = render ] && ! "$btf" help render >/dev/null 2>&1; then continue; fi
    # shellcheck disable=SC2086
    run $command measured.jpg --input cosine=inside
    expect "$command --input" 0
  done
  run compare measured.jpg cosine.btfd --input cosine=inside --json
  expect "compare sets what is measured, whatever else it compares" 0 '"rmse": 0'
  run compare imported.btfd imported.btfd --input cosine=inside
  expect "compare without measured data" 1 "imported.btfd: is no measured data; --input is for that"
  run import short.jpg -o x.btfd
  expect "import of a short file" 3 "ends within"
  [ ! -e x.btfd ] && pass || fail "a failed import left something behind"
  run encode measured.jpg -o measured.btfz --codec fmf -p components=1 -p storage=f32
  if [ "$status" != 1 ]; then
    expect "encode of measured data" 0 "ratio"
    run encode imported.btfd -o imported.btfz --codec fmf -p components=1 -p storage=f32
    run compare measured.btfz imported.btfz --json
    expect "encoding measured data equals encoding the imported folder" 0 '"rmse": 0'
    run info measured.btfz --input cosine=inside
    expect "--input of a container" 1 "measured.btfz: is no measured data; --input is for that"
    run info measured.btfz --format bonn-btf
    expect "--format of a container" 1 "--format"
    run encode measured.jpg -o inside.btfz --codec fmf -p components=1 --input cosine=inside
    run info inside.btfz
    expect "encode --input, recorded" 0 "--input cosine=inside"
  else
    skip "encode of measured data: no fmf"
  fi
fi
if grep -q '^bonn-images:' formats.txt && command -v python3 >/dev/null; then
  # 81 x 81 images of 2 x 1 texels, and the same without one and with one cut short.
  python3 - <<'END'
import struct, zipfile, zlib
rings = [(0, 1), (15, 6), (30, 12), (45, 18), (60, 20), (75, 24)]
directions = [(theta, i * 360 // count) for theta, count in rings for i in range(count)]
def chunk(tag, data):
    return struct.pack('>I', len(data)) + tag + data + struct.pack('>I', zlib.crc32(tag + data))
def png(codes):
    return (b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>IIBBBBB', 2, 1, 8, 2, 0, 0, 0)) +
            chunk(b'IDAT', zlib.compress(b'\0' + bytes(codes))) + chunk(b'IEND', b''))
with zipfile.ZipFile('images.zip', 'w', zipfile.ZIP_DEFLATED) as whole, zipfile.ZipFile('gaps.zip', 'w') as gaps, zipfile.ZipFile('cut.zip', 'w') as cut:
    for v, (tv, pv) in enumerate(directions):
        for l, (tl, pl) in enumerate(directions):
            name = 'tv%03d_pv%03d/tl%03d_pl%03d_tv%03d_pv%03d.png' % (tv, pv, tl, pl, tv, pv)
            data = png([40 + 2 * l, 30 + v, (7 * l + 3 * v) % 200, 60 + l, 200 - 2 * v, (l * v) % 251])
            whole.writestr(name, data)
            if (v, l) == (3, 5): data = data[:40]
            cut.writestr(name, data)
            if (v, l) != (40, 0): gaps.writestr(name, data)
END
  run info images.zip
  expect "info of a zip of images" 0 "images_transfer srgb"
  echo '0 0 80 0' >place.txt
  run fetch images.zip --input transfer=linear --input type=f32 <place.txt
  expect_numbers "codes of a zip of images" "0.784313738 0.117647059 0.627451003"
  run import gaps.zip -o x.btfd
  expect "import of a zip with gaps" 3 "1 of 6561 images are missing: tl000 pl000 tv060 pv054"
  head -c 20000 gaps.zip >half.zip
  run info half.zip
  expect "an archive that was cut short" 3 "no directory of a zip archive"
  run import gaps.zip -o filled.btfd --allow-missing --transfer linear
  expect "import --allow-missing" 0
  grep -q "2 of 6561 images are missing and filled in" err.txt && pass || fail "how many are filled is told" "$err"
  grep -q '"images_filled": *"2"' filled.btfd/manifest.json && grep -q '"images_damaged": *"1"' filled.btfd/manifest.json &&
    grep -q '"images_transfer": *"linear"' filled.btfd/manifest.json && pass || fail "what was filled is in the manifest"
  for command in "import -o x.btfd" check verify; do
    # shellcheck disable=SC2086
    run $command cut.zip
    expect "$command of a zip with an image cut short" 3 "cut.zip: tv015_pv120/tl015_pl240_tv015_pv120.png: PNG: the file ends too early"
  done
  run check cut.zip --input allow_missing=true
  expect "check of a zip whose damaged image is filled" 0 "not finite             0"
  run import images.zip -o x.btfd --transfer gamma
  expect "a transfer that is none" 1 "transfer"
  run encode images.zip -o images.btfz --codec fmf -p components=3
  if [ "$status" != 1 ]; then
    expect "encode of a zip of images" 0 "ratio"
    # The recorded command has base names: where they are the same, so are all bytes.
    mkdir alike
    run import images.zip -o alike/images.zip
    run encode alike/images.zip -o alike.btfz --codec fmf -p components=3
    cmp -s images.btfz alike.btfz && pass || fail "a zip and the folder imported from it are encoded to the same bytes"
    # With settings the commands differ; all other chunks are the same.
    run encode gaps.zip -o zip.btfz --codec fmf -p components=3 --allow-missing --transfer linear --input type=f32
    run import gaps.zip -o alike/gaps.zip --allow-missing --transfer linear -p type=f32 --type f32
    run encode alike/gaps.zip -o folder.btfz --codec fmf -p components=3
    for name in zip folder; do
      run info $name.btfz --json
      python3 - >$name.sums <<'END'
import json
print([(c['type'], c['tag'], c['checksum']) for c in json.load(open('out.txt'))['chunks'] if c['type'] != 'META'])
END
    done
    grep -q DATA zip.sums && cmp -s zip.sums folder.sums && pass || fail "floats of a zip are encoded as those of the folder" "$(cat zip.sums folder.sums)"
    run encode gaps.zip -o x.btfz --codec fmf
    expect "encode of a zip with gaps" 3 "allow_missing"
    [ ! -e x.btfz ] && pass || fail "a refused zip left a file behind"
  else
    skip "encode of a zip of images: no fmf"
  fi
else
  skip "zips of images: this build has no reader of them, or no python3"
fi
run import values.sh -o x.btfd
expect "import of nothing known" 2
run import -o x.btfd
expect "import without a path" 1 "PATH"
