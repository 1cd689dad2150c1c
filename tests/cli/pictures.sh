# SPDX-License-Identifier: MIT
# Materials of `btf synth`, pictures of `btf render`, contact sheets.

has_command() { [[ " $(echo $commands) " == *" $1 "* ]]; }

# stop_synth NAME SIGNAL DELAY: it ends within seconds and leaves nothing. It would take hours.
stop_synth() {
  local started waited
  "$btf" synth "$1" -o interrupted/x.btfd --spp 60000 -t 2 >out.txt 2>err.txt &
  local process=$!
  sleep "$3"
  kill -s "$2" "$process"
  started=$(date +%s%N)
  wait "$process"
  status=$?
  waited=$((($(date +%s%N) - started) / 1000000))
  err=$(cat err.txt)
  expect "synth $1 stopped by $2 after $3 s" 130 "interrupted"
  # A second is promised; the rest is for sanitizers and busy machines.
  [ "$waited" -lt 3000 ] && pass || fail "synth $1 goes on for $waited ms after $2"
  [ -z "$(leftovers interrupted)" ] && pass || fail "an interrupted synth leaves files" "$(ls -A interrupted)"
}

if has_command synth; then
  run synth lambert -o plain.btfd --size 2x2 --directions grid:2x1 -t 1
  expect "-t of synth is for threads as everywhere" 0 ""
  run synth lambert -o plain.btfd --size 2x2 --directions grid:2x1 -t f16
  expect "-t takes no type" 1 "--threads"
  run synth --list
  if grep -q '^carpet' out.txt; then
    mkdir interrupted
    set -m # a background job of a non-interactive shell ignores SIGINT unless told otherwise
    for name in carpet knit leather; do
      stop_synth $name INT 0.2
      stop_synth $name TERM 2.5
    done
    set +m
  fi
fi

# column.btfd: W x 2 texels, a bright row above a dark one.
make_column() { # W
  mkdir -p column.btfd
  cat >column.btfd/manifest.json <<END
{"format": "btf-dataset", "version": 1, "width": $1, "height": 2, "channels": ["Y"], "type": "u8", "order": "vlyxc",
 "views": [[0, 0, 1]], "lights": [[0, 0, 1]], "quantity": "brdf"}
END
  for row in '\063' '\314'; do
    for _ in $(seq "$1"); do printf "$row"; done
  done >column.btfd/samples.bin
}

if has_command render; then
  for scene in plane sphere; do
    # Two texels across a tile instead of one, and half as many tiles across: the same picture if texels are square.
    make_column 1
    run render column.btfd -o narrow.png --scene $scene --size 64x64 --spp 4 --finest --repeat 6
    expect "render of 1 x 2 texels" 0 ""
    make_column 2
    run render column.btfd -o wide.png --scene $scene --size 64x64 --spp 4 --finest --repeat 3
    expect "render of 2 x 2 texels" 0 ""
    cmp -s narrow.png wide.png && pass || fail "texels on the $scene are square"
    run render column.btfd -o other.png --scene $scene --size 64x64 --spp 4 --finest --repeat 6
    cmp -s other.png wide.png && fail "the $scene shows the size of texels" || pass
  done
  run render tiny.btfd -o x.png --rotate 30
  expect "--rotate without --env" 1 "--rotate turns the environment"
  run render tiny.btfd -o x.exr --exposure 1
  expect "--exposure of an .exr" 1 "--exposure is for PNG"
  run render tiny.btfd -o x.exr --tone filmic
  expect "--tone of an .exr" 1 "--tone is for PNG"
  run render tiny.btfd -o x.png --light 0,45 --env sky
  expect "two kinds of light" 1 "exclude each other"
  run render tiny.btfd -o x.png --scene cube
  expect "no such scene" 1 "plane, sphere, cloth or the path of an OBJ file"
  run render tiny.btfd -o x.png --scene shpere
  expect "misspelt scene" 1 "did you mean sphere?"
  run render tiny.btfd -o x.png --scene cube.obj
  expect "no such OBJ file" 2 "cube.obj"
  run render tiny.btfd -o x.jpg
  expect "a picture of another kind" 1 ".png or .exr"
  [ -z "$(ls x.* 2>/dev/null)" ] && pass || fail "a refused picture is written" "$(ls x.*)"
fi

# Contact sheets: of the name that says what they are, with headings that are whole.
run compare nowhere.btfd tiny.btfd --sheet sheet.jpg
expect "a sheet that is no PNG" 1 "ends in .png"
png_height() { od -An -tu1 -j 20 -N 4 "$1" | awk '{ print (($1 * 256 + $2) * 256 + $3) * 256 + $4 }'; }
long=a-file-whose-name-is-longer-than-a-column-is-wide.btfd
make_tiny $long brdf
run compare tiny.btfd changed.btfd --sheet short.png
expect "sheet" 0 ""
run compare tiny.btfd $long --sheet long.png
expect "sheet of a long name" 0 ""
# 52 characters in a column of 256 pixels, 12 pixels each: two lines of 20 pixels more.
[ $(($(png_height long.png) - $(png_height short.png))) = 40 ] && pass || fail "a long heading goes on below" "$(png_height long.png) $(png_height short.png)"
