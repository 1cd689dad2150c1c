# SPDX-License-Identifier: MIT
# Encoding and container files, where the build has the FMF codec; and files that are wrong.

# big.btfd: 16 x 16 texels, 24 lights and views, f16, with some structure.
make_big() {
  run synth bumps -o big.btfd --size 16x16 --directions grid:8x3
  [ "$status" = 0 ]
}

check_files() {
  run encode big.btfd -o big.btfz --codec fmf -p components=8
  expect "encode" 0 "big.btfz: "
  [[ $out == *bytes*ratio*" s" ]] && pass || fail "encode prints size, ratio and time" "$out"
  [ -z "$(ls -A | grep 'big.btfz.' || true)" ] && pass || fail "nothing beside the file" "$(ls -A)"
  run encode ./big.btfd/ --output=again.btfz --codec=fmf --param components=8 --json
  expect_json "encode --json"
  cmp -s big.btfz again.btfz && pass || fail "equal input and options give equal bytes"
  run info big.btfz
  expect "info of a container" 0 "btf encode big.btfd --codec fmf --param components=8"
  grep -q "$work" out.txt && fail "the file records a path" || pass
  run encode big.btfd -o small_memory.btfz --codec fmf -p components=8 -m 64
  run info small_memory.btfz
  expect "the file records the memory that the fit had" 0 "--param components=8 --memory 64"
  run info big.btfz --json
  expect_json "info --json of a container"
  grep -q '"checksum"' out.txt && pass || fail "info lists checksums"
  run verify big.btfz
  expect "verify" 0 "good"
  run compare big.btfd big.btfz --max-rmse 1
  expect "compare" 0 "PSNR"
  run compare --json big.btfd big.btfz again.btfz --sheet sheet.png
  expect_json "compare several"
  run compare tiny.btfd big.btfz
  expect "another shape" 7 "texels differ"
  run bench big.btfz --json --seconds 0.05
  expect_json "bench --json"
  if taskset -c 0 true 2>/dev/null; then # a process that may use one processor works with one thread
    taskset -c 0 "$btf" bench big.btfz --json --seconds 0.05 >out.txt 2>err.txt
    grep -q '^  "threads": 1,' out.txt && pass || fail "threads follow the processors allowed" "$(grep threads out.txt)"
  fi
  run bench big.btfz --seconds 0.05 -p components=4
  expect "bench of a container with parameters" 1 "compressed already"
  run bench big.btfz --seconds 0.05 --codec fmf
  expect "bench of a container with a codec" 1 "compressed already"
  run bench big.btfd --seconds 0.05 -p components=4
  expect "bench of a data set" 0 "encode "
  printf '0 0 0 0\n15 15 23 23\n' >indices.txt
  run fetch big.btfz -f indices.txt
  expect "fetch from a container" 0 ""
  [ "$(wc -l <out.txt)" = 2 ] && pass || fail "two samples" "$out"

  run encode big.btfd -o missed.btfz --codec fmf -p rmse=1e-7 -p max_components=2 --quiet
  expect "a target that is missed" 0 "missed.btfz: "
  [[ $err == "btf: warning: fmf: 2 components reach an rmse of "*"1e-07 was asked for"* ]] && pass || fail "warning of a missed target" "$err"
  run encode big.btfd -o missed.btfz --codec fmf -p psnr=150 -p max_components=2 --json
  expect_json "a target that is missed, as JSON"
  grep -q '"warnings": 1' out.txt && [[ $err == "btf: warning: fmf: 2 components reach a psnr of "*" dB; 150 dB was asked for" ]] && pass || fail "JSON counts the warnings" "$out" "$err"
  run encode big.btfd -o met.btfz --codec fmf -p psnr=20 --json
  grep -q '"warnings": 0' out.txt && [ -z "$err" ] && pass || fail "no warning of a target that is met" "$out" "$err"

  run encode big.btfd -o x.btfz --codec fmf -p componets=8
  expect "unknown parameter" 1 "componets"
  run encode big.btfd -o x.btfz --codec fmf -p components=many
  expect "parameter not a number" 1 "components"
  run encode big.btfd -o x.btfz --codec fmf -p components
  expect "parameter without a value" 1 "key=value"
  run encode big.btfd -o x.btfz --codec fnf
  expect "misspelt codec" 1 "did you mean fmf?"
  run encode big.btfz -o x.btfz --codec fmf
  expect "encode of an encoding" 1 "compressed already"
  run encode big.btfd/samples.bin -o x.btfz --codec fmf
  expect "encode of a data set's samples" 1 "give its folder, big.btfd"
  (cd big.btfd && "$btf" encode manifest.json -o ../x.btfz --codec fmf >../out.txt 2>../err.txt)
  status=$?
  err=$(cat err.txt)
  expect "encode of a data set's manifest" 1 "give its folder, ."
  run encode big.btfd -o nowhere/x.btfz --codec fmf
  expect "output in a missing folder" 2 "nowhere/x.btfz"
  run encode big.btfd -o /proc/x.btfz --codec fmf
  expect "output where nothing can be written" 2 "/proc/x.btfz"
  run encode big.btfd -o tiny.btfd --codec fmf
  expect "output is a folder" 2 "tiny.btfd"
  mkfifo pipe.btfz
  run encode big.btfd -o pipe.btfz --codec fmf
  expect "output is no regular file" 2 "not a regular file"
  [ -p pipe.btfz ] && pass || fail "a named pipe was replaced"
  if [ "$(id -u)" != 0 ]; then
    mkdir -m 555 locked
    run encode big.btfd -o locked/x.btfz --codec fmf
    expect "unwritable folder" 2 "locked/x.btfz"
  fi
  [ ! -e x.btfz ] && pass || fail "a failed encode leaves a file"

  # Damage: a byte in the middle of the payload, at the head, a cut.
  size=$(stat -c %s big.btfz)
  for at in $((size / 2)) $((size * 3 / 4)) 3; do
    cp big.btfz damaged.btfz
    byte=$(od -An -tu1 -j "$at" -N 1 big.btfz)
    printf "\\$(printf %03o $((byte ^ 64)))" | dd of=damaged.btfz bs=1 seek="$at" conv=notrunc 2>/dev/null
    run verify damaged.btfz
    expect "verify with byte $at flipped" 3 "damaged.btfz"
  done
  for length in 0 1 40 $((size / 2)) $((size - 1)); do
    head -c "$length" big.btfz >cut.btfz
    run verify cut.btfz
    expect "verify cut to $length bytes" 3 "cut.btfz"
    run eval cut.btfz </dev/null
    expect "eval cut to $length bytes" 3 "cut.btfz"
  done

  # A target picks the components.
  for target in psnr=40 rmse=0.1; do
    run encode big.btfd -o x.btfz --codec fmf -p components=3 -p $target
    expect "components beside $target" 1 "components has no effect beside ${target%=*}"
  done
  [ ! -e x.btfz ] && pass || fail "components beside a target are refused before the work"
  # A full disk: files may not grow beyond 1 KiB.
  mkdir full
  (ulimit -f 1 && "$btf" encode big.btfd -o full/x.btfz --codec fmf -p components=16 >full.out 2>full.err)
  status=$?
  cp full.out out.txt && cp full.err err.txt && out=$(cat out.txt) && err=$(cat err.txt)
  expect "full disk" 2 "x.btfz"
  [ -z "$(leftovers full)" ] && pass || fail "a full disk leaves files" "$(ls -A full)"
  for command in import convert; do
    (ulimit -f 1 && "$btf" $command big.btfd -o full/x.btfd >out.txt 2>err.txt)
    status=$?
    out=$(cat out.txt) && err=$(cat err.txt)
    expect "full disk while copying with $command" 2 "x.btfd"
    [ -z "$(leftovers full)" ] && pass || fail "a full disk leaves files of $command" "$(ls -A full)"
  done
  (ulimit -f 1 && "$btf" compare big.btfd big.btfz --sheet full/sheet.png >/dev/null 2>full.err)
  [ $? = 2 ] && [ -z "$(leftovers full)" ] && pass || fail "full disk while writing a picture" "$(cat full.err; ls -A full)"
}

check_interruption() {
  # The encode must be caught at work once; a run that was done before the signal is complete.
  local caught=0 delay
  run synth bumps -o wide.btfd --size 64x64 --directions grid:12x4
  mkdir stopped
  for signal in INT TERM; do
    caught=0
    for delay in 0.6 0.4 0.3 0.2 0.15 0.1 0.07 0.05 0.03; do
      "$btf" encode wide.btfd -o stopped/x.btfz --codec fmf -p components=200 -t 1 >out.txt 2>err.txt &
      local process=$!
      sleep "$delay"
      kill -s "$signal" "$process" 2>/dev/null
      wait "$process"
      status=$?
      out=$(cat out.txt)
      err=$(cat err.txt)
      if [ "$status" = 130 ]; then
        expect "encode stopped by $signal after $delay s" 130 "interrupted"
        [ -z "$(leftovers stopped)" ] && pass || fail "an interrupted encode leaves files" "$(ls -A stopped)"
        caught=1
        break
      fi
      [ "$status" = 0 ] || fail "encode stopped after $delay s" "status $status" "$err"
      rm -f stopped/x.btfz
    done
    [ "$caught" = 1 ] && pass || fail "no encode could be interrupted by $signal"
  done
}

if run codecs && grep -A1 '^fmf:' out.txt | grep -q 'capabilities: fit' && make_big; then
  check_files
  # A background job of a non-interactive shell ignores SIGINT unless told otherwise.
  set -m
  check_interruption
  set +m
else
  skip "encoding: this build has no FMF codec that fits, or no synth"
  run codecs
  if grep -q '^fmf:' out.txt; then
    run encode tiny.btfd -o x.btfz --codec fmf
    expect "encode in a build that only evaluates" 5 "only evaluate"
  fi
fi
