# SPDX-License-Identifier: MIT
# A data set small enough to compute by hand: 2 x 1 texels, one view from above, lights at (0, 0), (1/3, 0) and (0, 1/3)
# in parabolic coordinates, samples in fifths.

make_tiny() { # FOLDER QUANTITY
  mkdir -p "$1"
  cat >"$1/manifest.json" <<END
{"format": "btf-dataset", "version": 1, "width": 2, "height": 1, "channels": ["Y"], "type": "u8", "order": "vlyxc",
 "views": [[0, 0, 1]], "lights": [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]], "quantity": "$2", "name": "tiny",
 "an unknown key": {"is": ["ignored"]}}
END
  # 51, 102, 153, 204, 255, 0 of 255: 0.2, 0.4; 0.6, 0.8; 1, 0.
  printf '\063\146\231\314\377\000' >"$1/samples.bin"
}
make_tiny tiny.btfd brdf
make_tiny cosine.btfd brdf_cos

query() { # DATASET QUERY [OPTIONS]
  local file=$1 line=$2
  shift 2
  printf '%s\n' "$line" >query.txt
  run eval "$file" --queries query.txt "$@"
}

query tiny.btfd "0.25 0.5  0 0 1  0 0 1"
expect_numbers "at a sample" "0.2"
query tiny.btfd "0.75 0.5  0.6 0 0.8  0 0 1"
expect_numbers "at another sample" "0.8"
query tiny.btfd "0.5 0.5  0 0 1  0 0 1"
expect_numbers "half-way between texels" "0.3"
query tiny.btfd "0 0.5  0 0 1  0 0 1"
expect_numbers "across the periodic border" "0.3"
query tiny.btfd "1.25 -3.5  0 0 1  0 0 1"
expect_numbers "another tile" "0.2"
# (18, 18, 79) / 83 has the parabolic coordinates (1/9, 1/9): the middle of the triangle.
middle="0.21686746987951808 0.21686746987951808 0.95180722891566265"
query tiny.btfd "0.25 0.5  $middle  0 0 1"
expect_numbers "in the middle of three lights" "0.6"
query tiny.btfd "0.25 0.5  $middle  0 0 1" --value brdf_cos
expect_numbers "times the cosine" "0.571084337"
query tiny.btfd "0.25 0.5  $middle  0 0 1" --value stored
expect_numbers "as stored" "0.6"
query cosine.btfd "0.25 0.5  0.6 0 0.8  0 0 1"
expect_numbers "the cosine divided out" "0.75"
query cosine.btfd "0.25 0.5  0.6 0 0.8  0 0 1" --value=stored
expect_numbers "stored with its cosine" "0.6"
query cosine.btfd "0.25 0.5  0.6 0 0.8  0 0 1" --value brdf_cos
expect_numbers "f times cosine of a brdf_cos data set" "0.6"
# (2, 0, 3) / sqrt 13 lies at 1/(3.3..) between the first two lights, nearer to the second.
query tiny.btfd "0.4 0.5  0.5547001962252291 0 0.8320502943378437  0 0 1" --nearest
expect_numbers "nearest" "0.6"
query tiny.btfd "0.25 0.5  0 0 -1  0 0 1"
expect_numbers "light below the horizon" "0"
query tiny.btfd "0.25 0.5  0 0 1  1 0 0"
expect_numbers "view at the horizon" "0"
query tiny.btfd "0.25 0.5  nan 0 1  0 0 1"
expect_numbers "light not a number" "0"
query tiny.btfd "0.25 0.5  0 0 1  0 0 1" --lod 1
expect_numbers "coarser level" "0.3"
query tiny.btfd "0.75 0.5  0 0 1  0 0 1" --lod 0.5
expect_numbers "between levels" "0.35"

printf '0.25 0.5 0 0 1 0 0 1\r\n# a remark\r\n\r\n\t0.75  0.5 0 0 1 0 0 1  \r\n2.5e-1 +.5 0 0 1. 0 0 1' >query.txt
run eval tiny.btfd -f query.txt
expect_numbers "CRLF, remarks, blanks, tabs, exponents, no last line break" "0.2 0.4 0.2"
printf '0.25 0.5 0 0 1 0 0 1\n' | "$btf" eval tiny.btfd >out.txt 2>err.txt
[ "$(cat out.txt)" = "0.200000003" ] && pass || fail "standard input, nine digits" "$(cat out.txt err.txt)"
printf '0.25 0.5 0 0 1 0 0 1\n' | "$btf" eval tiny.btfd --queries - >out.txt 2>err.txt
[ "$(cat out.txt)" = "0.200000003" ] && pass || fail "standard input as -" "$(cat out.txt err.txt)"
run eval tiny.btfd </dev/null
expect "no queries" 0 ""
[ -z "$out" ] && pass || fail "no queries, no output" "$out"

# One query at a time, each answer before the next question.
mkfifo questions
"$btf" eval tiny.btfd <questions >answers 2>err.txt &
exec 3>questions
answers_given=0
for u in 0.25 0.75; do
  echo "$u 0.5 0 0 1 0 0 1" >&3
  for _ in $(seq 100); do
    [ "$(wc -l <answers)" -gt "$answers_given" ] && break
    sleep 0.05
  done
  [ "$(wc -l <answers)" -gt "$answers_given" ] && pass || fail "an answer for each question as it comes"
  answers_given=$((answers_given + 1))
done
exec 3>&-
wait $!
[ "$(echo $(cat answers))" = "0.200000003 0.400000006" ] && pass || fail "answers to a co-process" "$(cat answers err.txt)"

# More lines than a batch: 20000 queries, in order.
awk 'BEGIN { for (i = 0; i < 20000; i++) print (i % 2 ? 0.75 : 0.25), 0.5, 0, 0, 1, 0, 0, 1 }' >query.txt
run eval tiny.btfd -f query.txt
[ "$status" = 0 ] && [ "$(sort out.txt | uniq -c | awk '{ print $1, $2 }' | tr '\n' ' ')" = "10000 0.200000003 10000 0.400000006 " ] &&
  [ "$(sed -n 10001p out.txt)" = 0.200000003 ] && pass || fail "20000 queries" "$status $(wc -l <out.txt)"

for bad in "0.5 0.5 0 0 1 0 0|7 numbers" "0.5 0.5 0 0 1 0 0 1 2|more than 8" "0.5 0.5 0 0 one 0 0 1|\"one\" is not a number" \
  "0.5,0.5 0 0 1 0 0 1 1|not a number" "0.5 0.5 0 0 2 0 0 1|light direction has length 2" \
  "0.5 0.5 0 0 1 0.5 0.5 0.5|view direction has length 0.866" "0x1p1 0 0 0 1 0 0 1|not a number"; do
  printf '0.25 0.5 0 0 1 0 0 1\n%s\n' "${bad%%|*}" >query.txt
  run eval tiny.btfd -f query.txt
  expect "eval: ${bad%%|*}" 3 "query.txt: line 2: "
  [[ $err == *"${bad##*|}"* ]] && pass || fail "eval: message for ${bad%%|*}" "$err"
  [ "$out" = "0.200000003" ] && pass || fail "eval: lines before the bad one are answered" "$out"
done
printf '0.25 0.5 0 0 1 0\0000 0 1\n' >query.txt
run eval tiny.btfd -f query.txt
expect "a NUL in a line" 3 "line 1"
head -c 2000000 /dev/zero | tr '\0' 7 >query.txt
run eval tiny.btfd -f query.txt
expect "an endless line" 3 "line 1: longer"
run eval tiny.btfd -f nowhere.txt
expect "no such query file" 2 "nowhere.txt"

printf '0 0 0 0\n1 0 1 0\n0 0 2 0\n1 0 2 0\n' >indices.txt
run fetch tiny.btfd -f indices.txt
expect_numbers "fetch" "0.2 0.8 1 0"
run fetch cosine.btfd -f indices.txt
expect_numbers "fetch does not divide" "0.2 0.8 1 0"
for bad in "2 0 0 0|x is 2; the file has 0 to 1" "0 1 0 0|y is 1" "0 0 3 0|light is 3" "0 0 0 1|view is 1" "0 0 0|3 numbers" \
  "0 0 0 0 0|more than 4" "-1 0 0 0|not an index" "0.5 0 0 0|not an index" "99999999999 0 0 0|not an index"; do
  printf '0 0 0 0\n%s\n' "${bad%%|*}" >indices.txt
  run fetch tiny.btfd -f indices.txt
  expect "fetch: ${bad%%|*}" 3 "indices.txt: line 2: "
  [[ $err == *"${bad##*|}"* ]] && pass || fail "fetch: message for ${bad%%|*}" "$err"
done

run info tiny.btfd
expect "info of a data set" 0 "2 x 1"
run info --json tiny.btfd
expect_json "info --json of a data set"
if command -v python3 >/dev/null; then
  got=$(python3 -c 'import json,sys; d=json.load(open("out.txt")); print(d["kind"], d["width"], d["height"], d["channels"], len(d["lights"]), d["views"], d["name"])')
  [ "$got" = "dataset 2 1 ['Y'] 3 [[0, 0, 1]] tiny" ] && pass || fail "what info --json says" "$got"
fi
run verify tiny.btfd
expect "verify a data set" 0 "6 samples"
run compare tiny.btfd tiny.btfd --exact
expect "compare with itself" 0 "6, 0 differ"
run compare tiny.btfd cosine.btfd
expect "another quantity" 7 "brdf_cos"

# One value changed by 0.2: RMSE sqrt(0.04 / 6), values in fifths, so that the 99.9th percentile is 0.999 * 5 = 4.995 of the
# way: 0.8 + 0.995 * 0.2 = 0.999.
make_tiny changed.btfd brdf
printf '\063\146\231\314\377\063' >changed.btfd/samples.bin
run compare tiny.btfd changed.btfd --json
expect_json "compare --json"
if command -v python3 >/dev/null; then
  python3 - >figures.txt 2>&1 <<'END'
import json, math
d = json.load(open("out.txt"))
expected = {"rmse": math.sqrt(0.04 / 6), "peak": 0.999, "psnr": 20 * math.log10(0.999 / math.sqrt(0.04 / 6)),
            "largest_error": 0.2, "relative_rmse": math.sqrt(0.04 / (0.04 + 0.16 + 0.36 + 0.64 + 1)),
            "mean_relative_error": 0.2 / 0.000999 / 6, "raw_bytes": 6, "different": 1, "values": 6, "ssim_images": 3}
for key, value in expected.items():
    if abs(d[key] - value) > 1e-6 * abs(value): print(key, d[key], value)
for key, value in {"worst_texel": {"x": 1, "y": 0}, "worst_pair": {"light": 2, "view": 0}}.items():
    for k, v in value.items():
        if d[key][k] != v: print(key, k, d[key][k], v)
if d["rmse_y"] is not None: print("rmse_y", d["rmse_y"])
END
  [ ! -s figures.txt ] && pass || fail "figures of compare" "$(cat figures.txt)"
fi
run compare tiny.btfd changed.btfd --exact
expect "compare --exact" 7 "1 of 6 values differ"
run compare tiny.btfd changed.btfd --max-rmse 0.01
expect "compare --max-rmse" 7 "RMSE is 0.0816"
run compare tiny.btfd changed.btfd --min-psnr 20
expect "compare --min-psnr met" 0 "PSNR"
run compare tiny.btfd changed.btfd cosine.btfd
expect "one of several does not fit" 7 "cosine.btfd"
run compare tiny.btfd changed.btfd tiny.btfd --json
expect_json "compare --json of several files"
run compare tiny.btfd changed.btfd --sheet sheet.png
expect "contact sheet" 0 ""
[ "$(head -c 4 sheet.png | tail -c 3)" = PNG ] && pass || fail "the sheet is a PNG file"
