# SPDX-License-Identifier: MIT
# btf check: a data set is spoilt in one way at a time, and that is what must be found, where it is.

if ! command -v python3 >/dev/null || ! "$btf" synth --list >/dev/null 2>&1; then
  skip "check: no python3 or no synth"
else
  run synth bumps -o sound.btfd --size 8x8 --directions grid:8x4 --type f32 -q
  run check sound.btfd --json
  expect_json "check --json"
  expect "a sound data set has no problems" 0 '"problems": ?]'
  expect "the cosine is outside of a brdf" 0 '"cosine": "outside"'
  # spoil NAME QUANTITY CODE: a copy whose samples s[view, light, y, x, channel], with d the light directions, CODE has changed.
  spoil() {
    rm -rf "$1.btfd"
    cp -r sound.btfd "$1.btfd"
    python3 - "$1.btfd" "$2" "$3" <<'END'
import array, json, sys
path, quantity, code = sys.argv[1:]
m = json.load(open(path + '/manifest.json'))
m['quantity'] = quantity
json.dump(m, open(path + '/manifest.json', 'w'))
V, L, H, W, C = len(m['views']), len(m['lights']), m['height'], m['width'], len(m['channels'])
s = array.array('f')
s.frombytes(open(path + '/samples.bin', 'rb').read())
at = lambda v, l, y, x, c: (((v * L + l) * H + y) * W + x) * C + c
everywhere = [(v, l, y, x, c) for v in range(V) for l in range(L) for y in range(H) for x in range(W) for c in range(C)]
d = m['lights']
exec(code)
open(path + '/samples.bin', 'wb').write(s.tobytes())
END
    run check "$1.btfd" --json
  }
  cosine='for p in everywhere: s[at(*p)] *= d[p[1]][2]'
  spoil inside brdf "$cosine"
  expect "a cosine that is not declared" 0 '"problems": ?"cosine_inside"?'
  spoil declared brdf_cos "$cosine"
  expect "a cosine that is declared" 0 '"problems": ?]'
  spoil outside brdf_cos 'pass'
  expect "a cosine that is declared and not there" 0 '"problems": ?"cosine_outside"?'
  spoil undefined brdf 's[at(4, 5, 6, 7, 1)] = float("nan")'
  expect "NaN" 0 '"problems": ?"not_finite"?'
  expect "the place of NaN" 0 '"not_finite": {"count": 3, "x": 7, "y": 6, "light": 5, "view": 4}'
  spoil negative brdf 's[at(1, 2, 3, 4, 2)] = -1'
  expect "a negative value" 0 '"negative": {"count": 1, "x": 4, "y": 3, "light": 2, "view": 1}'
  spoil black brdf 'for p in everywhere:
  if p[0] == 3 and p[1] == 6: s[at(*p)] = 0'
  expect "a black picture" 0 '"problems": ?"missing"?'
  expect "which picture is black" 0 '"missing": {"count": 1, "x": 0, "y": 0, "light": 6, "view": 3}'
  spoil dead brdf 'for p in everywhere:
  if p[2] == 2 and p[3] == 5: s[at(*p)] = 0.1'
  expect "a dead texel" 0 '"problems": ?"dead"?'
  expect "which texel is dead" 0 '"dead": {"count": 1, "x": 5, "y": 2'
  # Light 18 has neighbours on all sides; ln 1.5 is 0.41.
  spoil flicker brdf 'for p in everywhere:
  if p[1] == 18: s[at(*p)] *= 1.5'
  expect "a light that was brighter" 0 '"problems": ?"flicker"?'
  expect "which light was brighter" 0 '"flicker_light_index": 18'
  spoil cut brdf 'most = max(s)
for p in everywhere: s[at(*p)] = min(s[at(*p)], 0.3 * most)'
  expect "highlights that are cut off" 0 '"problems": ?"saturated"?'
  spoil bright brdf 'for p in everywhere: s[at(*p)] *= 5'
  expect "more light than there is" 0 '"problems": ?"albedo"?'
  # The albedo of a Lambertian surface is known: (0.8 + 0.5 + 0.2) / 3. The sum over 65536 directions is within 1e-4 of the
  # integral, and interpolation of a constant is exact.
  run synth lambert -o lambert.btfd --size 2x2 --directions grid:8x4 --type f32 -q
  run check lambert.btfd
  expect "albedo of a Lambertian surface" 0 "0.5000 at most"
  expect "a constant has no dead texels among living ones" 0 "no problems found"
  # With the cosine, its largest values are those of the lights nearest to the normal, for every view.
  rm -rf sound.kept && mv sound.btfd sound.kept && cp -r lambert.btfd sound.btfd
  spoil matte brdf_cos "$cosine"
  expect "a matte surface is not cut off" 0 '"problems": ?]'
  rm -rf sound.btfd && mv sound.kept sound.btfd
  # Nothing is wrong with what synth makes, and coarse directions are no problem of the data.
  for material in $("$btf" synth --list | cut -d: -f1 | cut -d' ' -f1); do
    rm -rf made.btfd
    "$btf" synth "$material" -o made.btfd --size 6x6 --directions grid:8x4 --spp 4 --type f32 -q
    run check made.btfd --json
    expect "check of $material" 0 '"problems": ?]'
    [ "$material" = furnace ] || expect "the cosine of $material" 0 '"cosine": "outside"'
  done
  # What the reader had to make up is told.
  sed -i 's/"format": "btf-dataset",/&\n  "images_filled": "3",/' sound.btfd/manifest.json
  run check sound.btfd --json
  expect "pictures that were filled in" 0 '"problems": ?"filled"?'
  sed -i '/images_filled/d' sound.btfd/manifest.json
  # All of a larger set: texels are not told apart for ever.
  run synth plane -o void.btfd --size 128x128 --directions grid:4x2 --type f32 --spp 1 --bounces 1 -q
  python3 -c 'import sys; n = len(open("void.btfd/samples.bin", "rb").read()) // 4; open("void.btfd/samples.bin", "wb").write(b"\0\0\xc0\x7f" * n)'
  run check void.btfd --json
  expect "a set without finite values" 0 '"not_finite": {"count": [0-9]'
  run check sound.btfd --sheet audit.png
  expect "check --sheet" 0 "no problems found"
  [ "$(head -c 4 audit.png | tail -c 3)" = PNG ] && pass || fail "check --sheet writes a picture"
  run check sound.btfd --sheet audit.jpg
  expect "a sheet of an ending that is not written" 1 ".png or .exr"
  [ -z "$out" ] && [ ! -e audit.jpg ] && pass || fail "no audit before a sheet that is refused"
  run check sound.btfd --sheet no/such/folder.png
  expect "a sheet that cannot be written" 2 "folder"
fi
run check absent.btfd
expect "check of nothing" 2 "absent"
