# SPDX-License-Identifier: MIT
# Wrong data sets, closed pipes, full outputs, odd names.

wrong() { # NAME STATUS PATTERN, after a change to wrong.btfd
  run verify wrong.btfd
  expect "$1" "$2" "$3"
  make_tiny wrong.btfd brdf
}
make_tiny wrong.btfd brdf
rm wrong.btfd/samples.bin
wrong "no samples" 2 "samples.bin"
printf 'x' >>wrong.btfd/samples.bin
wrong "one byte too many" 3 "samples.bin"
printf 'x' >wrong.btfd/samples.bin
wrong "samples cut short" 3 "6"
rm wrong.btfd/manifest.json
wrong "no manifest" 3 "wrong.btfd"
printf '{"format": ' >wrong.btfd/manifest.json
wrong "manifest cut short" 3 "manifest.json"
sed -i 's/"version": 1/"version": 2/' wrong.btfd/manifest.json
wrong "newer data set" 5 "version"
sed -i 's/"width": 2/"width": 99999999/' wrong.btfd/manifest.json
wrong "absurd width" 3 "width"
sed -i 's/\[0.6, 0, 0.8\]/[0.6, 0, -0.8]/' wrong.btfd/manifest.json
wrong "light below the horizon" 3 "light"
sed -i 's/\[0.6, 0, 0.8\]/[0.6, 0, 0.9]/' wrong.btfd/manifest.json
wrong "light not a unit vector" 3 "light"
sed -i 's/"type": "u8"/"type": "f32"/' wrong.btfd/manifest.json
printf '\0\0\200\077\0\0\200\077\0\0\200\077\0\0\300\177\0\0\200\077\0\0\200\077' >wrong.btfd/samples.bin
cp -r wrong.btfd nan.btfd
wrong "a sample that is not a number" 3 "not finite"
for command in eval fetch "render -o nan.png"; do
  # shellcheck disable=SC2086
  run ${command%% *} nan.btfd ${command#"${command%% *}"} </dev/null
  expect "$command of a sample that is not a number" 3 "view 0, light 1, row 0, column 1, channel 0 is not finite"
done
[ ! -e nan.png ] && pass || fail "an image of a sample that is not a number"
printf 'junk junk junk junk junk junk junk junk junk junk' >junk.btfz
for command in info verify eval fetch bench; do
  run $command junk.btfz </dev/null
  expect "$command of junk" 3 "junk.btfz"
done
: >empty.btfz
run info empty.btfz
expect "an empty file" 3 "empty.btfz"

# A reader that goes away ends the program as it ends other filters, without a word.
awk 'BEGIN { for (i = 0; i < 100000; i++) print 0.25, 0.5, 0, 0, 1, 0, 0, 1 }' >query.txt
{ "$btf" eval tiny.btfd -f query.txt 2>err.txt; echo $? >status.txt; } | head -1 >/dev/null
[ "$(cat status.txt)" = 141 ] && [ ! -s err.txt ] && pass || fail "closed pipe" "status $(cat status.txt)" "$(cat err.txt)"
if [ -e /dev/full ]; then
  "$btf" eval tiny.btfd -f query.txt >/dev/full 2>err.txt
  status=$?
  err=$(cat err.txt)
  expect "full standard output" 2 "standard output"
  "$btf" --help >/dev/full 2>err.txt
  status=$?
  err=$(cat err.txt)
  expect "full standard output of help" 2 "standard output"
fi
"$btf" info tiny.btfd >&- 2>err.txt
[ $? = 2 ] && pass || fail "closed standard output" "$(cat err.txt)"

# Names are shown without control characters and stay JSON.
odd=$'odd "name"\\ \033[31m\n.btfd'
make_tiny "$odd" brdf
run info --json "$odd"
expect_json "odd name in JSON"
run info "$odd"
expect "odd name" 0 "2 x 1"
[[ $out != *$'\033'* ]] && pass || fail "an escape sequence reaches the terminal"
for bytes in $'caf\303\251' $'latin\351' $'over\300\257' $'cut\342\202' $'half\355\240\200'; do
  make_tiny "$bytes.btfd" brdf
  run info --json "$bytes.btfd"
  expect_json "bytes in a name: $(printf %s "$bytes" | od -An -tx1)"
done
run info "no such $odd"
expect "odd name in a message" 2 "no such odd"

# The locale changes nothing.
for locale in $(locale -a 2>/dev/null | grep -E '^(de_DE|fr_FR|fi_FI)' | head -2); do
  LC_ALL=$locale "$btf" eval tiny.btfd -f query.txt 2>/dev/null | head -1 >out.txt
  [ "$(cat out.txt)" = 0.200000003 ] && pass || fail "numbers in $locale" "$(cat out.txt)"
done

# signalled NAME SIGNAL STATUS PATTERN: a command that waits for its input gets a signal.
set -m
mkfifo silence
signalled() {
  exec 4<>silence
  "$btf" eval tiny.btfd <silence 4>&- >out.txt 2>err.txt &
  local waiting=$!
  sleep 0.3
  kill -s "$2" "$waiting"
  wait "$waiting"
  status=$?
  err=$(cat err.txt)
  expect "$1" "$3" "$4"
  exec 4>&-
}
# A page of a mapped file that went away ends a command with a line; one that only reads ends at once.
signalled "a file that became shorter" BUS 2 "became shorter"
signalled "eval interrupted while it waits" INT 130 "interrupted"
set +m
