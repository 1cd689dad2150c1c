# SPDX-License-Identifier: MIT
# The same data in another form. `measured.jpg` is the factored file of measured.sh.

if [ ! -e measured.jpg ]; then
  skip "convert: no factored file was made"
elif ! "$btf" codecs fmf >/dev/null 2>&1; then
  skip "convert: no fmf"
else
  run convert measured.jpg kept.btfz
  expect "convert a factored file" 0 "kept.btfz: fmf"
  run compare measured.jpg kept.btfz --exact
  expect "factors are kept as they are" 0 ""
  run info kept.btfz
  expect "what is recorded" 0 "btf convert measured.jpg"
  expect "notes of the measurement" 0 "bonn_setup*dome"
  if "$btf" encode imported.btfd -o noted.btfz --codec fmf -p components=1 >/dev/null 2>&1; then
    run info noted.btfz
    expect "notes by way of a folder" 0 "bonn_setup*dome"
  fi
  run convert measured.jpg again.btfz -t 2
  cmp -s kept.btfz again.btfz && pass || fail "the name of the output and the threads change the bytes"
  run convert kept.btfz packed.btfz -p storage=f32 -p coding=packed
  expect "convert a container" 0 "packed.btfz: fmf"
  run compare measured.jpg packed.btfz --max-rmse 1e-6
  expect "packed factors" 0 ""
  run convert measured.jpg cosine.btfz --format bonn-btf --input cosine=inside
  run info cosine.btfz
  expect "a parameter of the format read" 0 "brdf_cos"
  run convert imported.btfd x.btfz
  expect "convert samples to factors" 5 "holds samples and no factors; btf encode"
  run convert measured.jpg x.dat
  expect "a name that tells nothing" 1 "--to"
  run convert measured.jpg x.btfz --to fmd
  expect "a misspelt codec" 1 "did you mean fmf?"
  run convert measured.jpg x.btfz -p components=3
  expect "a parameter of a fit" 1 "no effect"
  run convert measured.jpg x.btfz --to lafortune
  [ "$status" = 1 ] || expect "a codec without factors" 5 "cannot hold given factors"
  run convert measured.jpg x.btfz --format merl
  expect "the wrong format of IN" 3 "measured.jpg"
  run convert short.jpg x.btfz
  expect "convert a short file" 3 "ends within"
  [ ! -e x.btfz ] && pass || fail "a failed conversion left something behind"
  run convert measured.jpg nowhere/x.btfz
  expect "a place that is not there" 2 "nowhere"
  run convert measured.jpg samples.btfd
  expect "convert to a folder" 0 "samples.btfd: folder"
  grep -q '"type": *"f32"' samples.btfd/manifest.json && pass || fail "floats stay floats"
  run compare measured.jpg samples.btfd --exact
  expect "samples of a folder" 0 ""
  for type in u8 u16 f16; do
    run convert samples.btfd $type.btfd --type $type
    run convert $type.btfd -o kept.btfd
    expect "convert with -o" 0 "kept.btfd: folder"
    grep -q "\"type\": *\"$type\"" kept.btfd/manifest.json && pass || fail "$type stays $type"
    run compare $type.btfd kept.btfd --exact
    expect "samples of $type as they are" 0 ""
  done
  # Values are (l + 1) (v + 1) (10 y + x + 1) / 256 in three channels: up to 12 * 22 / 256, of which only that of the last
  # light, view and texel is above 1.
  run convert measured.jpg u8.btfd --type u8
  expect "convert to integers" 0 "u8.btfd: folder"
  grep -q "3 of 216 values (1.39 %).*u8 does not hold" err.txt && pass || fail "how many values are clipped is told" "$err"
  run import measured.jpg -o u16.btfd --type u16 -q
  expect "import to integers" 0 ""
  [ -z "$out" ] && grep -q "3 of 216 values.*u16" err.txt && pass || fail "import tells what it clips and no more" "$out$err"
  run convert measured.jpg x.btfd -o y.btfd
  expect "OUT twice" 1 "given twice"
  run convert kept.btfz decoded.btfd --type f32
  run compare measured.jpg decoded.btfd --exact
  expect "a container as a folder" 0 ""
  if python3 -c 'import numpy' 2>/dev/null; then
    # The three lines of docs/formats.md.
    python3 - <<'END' && pass || fail "numpy reads the folder"
import json, numpy as np
m = json.load(open("samples.btfd/manifest.json"))
a = np.memmap("samples.btfd/samples.bin", "<f4", "r", shape=(len(m["views"]), len(m["lights"]), m["height"], m["width"], len(m["channels"])))
v, l, y, x, c = np.indices(a.shape)
assert (a == (l + 1) * (v + 1) * (10 * y + x + 1) / 256).all()
END
  else
    skip "numpy reads the folder: no numpy"
  fi
  # Each view by itself, as PVF: the same values and a mean of 1/4 a light.
  python3 - <<'END'
import struct
u32 = lambda *v: struct.pack('<%dI' % len(v), *v)
f32 = lambda *v: struct.pack('<%df' % len(v), *v)
head = open('measured.jpg', 'rb').read()[8:-(1 + 4 * 4 + 4 * 36 + 4 * 6 + 4 * 3)]
out = b'!PVF06FC' + head + u32(2, 3, 1, 3)
for v in range(3):
    out += bytes([4]) + u32(1, 6, 4 * 3) + f32(1) + f32(*[0.25 * (l + 1) for l in range(4) for c in range(3)])
    out += f32(*[(l + 1) * (v + 1) for l in range(4) for c in range(3)])
    out += f32(*[(10 * (2 - row) + x + 1) / 256 for row in range(3) for x in range(2)])
open('views.btf', 'wb').write(out)
END
  if "$btf" codecs pvpca >/dev/null 2>&1; then
    run convert views.btf views.btfz
    expect "convert a file of views" 0 "views.btfz: pvpca"
    run compare views.btf views.btfz --exact
    expect "factors of views are kept as they are" 0 ""
    printf '0 0 0 0\n1 2 3 2\n' >places.txt
    run fetch views.btfz <places.txt
    expect "means of views" 0 "0.25390625 0.25390625 0.25390625
2.03125 2.03125 2.03125"
    run convert views.btfz again.btfz -p storage=q8
    expect "a container of views" 0 "again.btfz: pvpca"
    run compare views.btf again.btfz --max-rmse 0.003
    expect "bytes of views" 0 ""
    run convert views.btf x.btfz -p components=3
    expect "a parameter of a fit of views" 1 "components has no effect"
    run convert measured.jpg x.btfz --to pvpca
    expect "all views in one to pvpca" 5 "which fmf holds"
  else
    skip "convert: no pvpca"
  fi
  run convert views.btf x.btfz --to fmf
  expect "views by themselves to fmf" 5 "each view"
  for family in fmf dfmf; do
    run convert kept.btfz written.btf --to bonn-btf -p family=$family -p scalar=float
    expect "write $family" 0 "written.btf: bonn-btf"
    run compare measured.jpg written.btf --max-rmse 1e-7
    expect "$family is read back" 0 ""
  done
  run convert imported.btfd x.btf --to bonn-btf
  expect "samples as factors" 5 "holds samples"
  if "$btf" convert --list | grep -q '^bonn-images' && "$btf" synth bumps -o table.btfd --size 4x4 --directions ubo81 -q 2>/dev/null; then
    # Thousands of files: in memory, where they can be.
    shelf=$(mktemp -d -p /dev/shm 2>/dev/null || mktemp -d -p "$work")
    run convert table.btfd "$shelf/images" --to bonn-images
    expect "write images" 0 "images: bonn-images"
    run convert "$shelf/images" "$shelf/again" --to bonn-images
    expect "write images anew" 0 "again: bonn-images"
    diff -rq "$shelf/images" "$shelf/again" >/dev/null && pass || fail "images that were read come out again"
    run convert measured.jpg "$shelf/other" --to bonn-images
    expect "images of other directions" 0 "other: bonn-images"
    case $err in *"nearest sample is up to"*) pass ;; *) fail "interpolated images are told" "$err" ;; esac
    rm -rf "$shelf"
  else
    skip "convert: no images"
  fi
  run convert measured.jpg x.btf --to bonn-btf -p cosine=inside
  expect "a parameter of reading" 1 "family, scalar"
  run convert measured.jpg x.btf --to bonn-btf --type f32
  expect "a type for factors" 1 "--type"
  run convert measured.jpg x.btfd -p type=f32
  expect "a parameter for a folder" 1 "--type"
  run convert measured.jpg x.bin --to merl
  [ "$status" = 1 ] || expect "a format that is only read" 5 "only read"
  [ ! -e x.btf ] && [ ! -e x.btfd ] && pass || fail "a failed conversion left something behind"
  run convert --list
  expect "what can be written" 0 "-p family="
  mkdir taken.btfz
  run convert measured.jpg taken.btfz
  expect "a folder in the place of a container" 2 "is a folder"
  rmdir taken.btfz
fi
run convert measured.jpg
expect "convert without OUT" 1 "OUT is missing"
