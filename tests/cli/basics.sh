# SPDX-License-Identifier: MIT
# Help, version, usage errors.

run --version
expect "version" 0 "btf "
run --help
expect "program help" 0 "Usage: btf COMMAND"
commands=$(sed -n '/^Commands:/,/^$/s/^  \([a-z]*\) .*/\1/p' out.txt)
[ "$(printf '%s\n' $commands | wc -l)" -ge 10 ] && pass || fail "the program's help lists the commands" "$commands"

for command in $commands; do
  run "$command" --help
  expect "$command --help" 0 "Usage: btf $command"
  # synth and render have tests of their own.
  case $command in synth | render) continue ;; esac
  [ "${UPDATE:-}" = 1 ] && cp out.txt "$here/help/$command.txt"
  if diff -u "$here/help/$command.txt" out.txt >difference.txt; then
    pass
  else
    fail "recorded help of $command" "$(head -20 difference.txt)"
  fi
  cp out.txt long.txt
  run help "$command"
  cmp -s out.txt long.txt && pass || fail "help $command equals $command --help"
  run "$command" -h
  cmp -s out.txt long.txt && pass || fail "$command -h equals $command --help"
done
# Nobody needs to scroll sideways.
for file in "$here"/help/*.txt; do
  [ "$(awk '{ if (length($0) > 120) print }' "$file" | wc -l)" = 0 ] && pass || fail "$file is wider than 120 columns"
done

"$btf" >out.txt 2>err.txt
[ $? = 1 ] && [ ! -s out.txt ] && grep -q "Usage: btf" err.txt && pass || fail "no arguments: help on standard error, status 1"

run encod
expect "misspelt command" 1 "did you mean encode?"
run frobnicate
expect "unknown command" 1 'unknown command "frobnicate"'
run help frobnicate
expect "help of an unknown command" 1 "frobnicate"
run --frob
expect "unknown option before a command" 1 "--frob"
run info --jsno x
expect "misspelt option" 1 "did you mean --json?"
run info --frob x
expect "unknown option" 1 "unknown option --frob"
run info -Z x
expect "unknown letter" 1 "unknown option -Z"
run info
expect "no file" 1 "no file given"
run info a b
expect "too many files" 1 'unexpected argument "b"'
run compare a
expect "one file to compare" 1 "argument is missing"
run info --json=yes x
expect "value for a switch" 1 "--json takes no value"
run eval x --lod
expect "option without its value" 1 "--lod needs a value"
run eval x --lod --json
expect "an option for the value of another" 1 '--lod needs a value (L), not "--json"'
run encode x -o -c fmf
expect "a letter for the value of another" 1 '-o needs a value (PATH), not "-c"'
run eval x --lod=-deep
expect "a value after = may be anything" 1 '--lod is "-deep"'
run eval x --lod=deep
expect "lod is not a number" 1 '--lod is "deep"'
run eval x --lod -1
expect "lod out of range" 1 '--lod is "-1"'
run eval x --value colour
expect "unknown value" 1 "brdf, brdf_cos or stored"
run info x --threads 0
expect "no threads" 1 "--threads"
run info x --threads 1025
expect "more threads than a context takes" 1 "from 1 to 1024"
run info -t many x
expect "threads not a number" 1 "--threads"
run encode x -o y
expect "encode without codec" 1 "--codec is missing"
run encode x --codec fmf
expect "encode without output" 1 "--output is missing"
run encode x -o y --codec fmf --memory 0
expect "no memory" 1 "--memory"
run info nowhere
expect "no such file" 2 "nowhere"
run info -- --json
expect "-- ends options" 2 "--json: could not be opened"
run codecs --plugin relative.so
expect "plug-in by relative path" 1 "absolute path"
run codecs --plugin "$work/none.so"
expect "missing plug-in" 2 "none.so: could not be opened"
printf 'not a module' >text.so
run codecs --plugin "$work/text.so"
expect "a plug-in that is no module" 4 "text.so"
rm text.so
run codecs nosuchcodec
expect "unknown codec" 1 "nosuchcodec"
run codecs
expect "codecs" 0 ""
run codecs --json
expect_json "codecs --json"

# The manual knows every command, and formats without a warning.
manual=$here/../../docs/man/btf.1
for command in $commands; do
  grep -q "^.fB$command.fR" "$manual" && pass || fail "the manual lacks $command"
  grep -q "^## .*$command" "$here/../../docs/command-line.md" && pass || fail "docs/command-line.md lacks $command"
done
if command -v groff >/dev/null; then
  groff -man -ww -Tutf8 -z "$manual" 2>err.txt
  [ $? = 0 ] && [ ! -s err.txt ] && pass || fail "warnings of the manual" "$(cat err.txt)"
else
  skip "the manual's format: no groff"
fi
