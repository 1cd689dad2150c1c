# SPDX-License-Identifier: MIT
# Files that are whole and mean harm, and names of files that do.

# What the last run printed, on either side, that a terminal would obey or take for a line break: controls but LF, and the
# marks U+2028 to U+202E, U+2066 to U+2069.
expect_harmless() {
  if cat out.txt err.txt | LC_ALL=C grep -qaP '[\x00-\x09\x0b-\x1f\x7f]|\xc2[\x80-\x9f]|\xe2\x80[\xa8-\xae]|\xe2\x81[\xa6-\xa9]'; then
    fail "$1: controls are printed" "$(od -c out.txt | head -20)"
  else
    pass
  fi
}

if ! printf 'x' | grep -qP x 2>/dev/null; then
  skip "hostile text: grep -P is not there"
else
  # C0, C1 as UTF-8 and as a lone byte, a mark of direction: in the name of a file that is there, and of one that is not.
  evil=$(printf 'evil\033[31m\302\233x\233\342\200\256y')
  cp -r tiny.btfd "$evil.btfd"
  for command in info verify "compare tiny.btfd"; do
    run $command "$evil.btfd"
    expect "$command of a hostile name" 0 "evil?[31m?x??y.btfd"
    expect_harmless "$command of a hostile name"
    run $command "$evil.gone"
    expect "$command of a hostile name that is not there" 2 "evil?[31m?x??y.gone"
    expect_harmless "$command of a hostile name that is not there"
  done
  run info --json "$evil.btfd"
  expect_json "info --json of a hostile name"
  expect_harmless "info --json of a hostile name"
fi

mkdir hostile
[ -n "$hostile" ] && "$hostile" hostile >out.txt 2>err.txt
case $? in
0)
  run info hostile/models.btfz
  expect "notes are with their models" 0 "setup           a dome*model 0*model 1*setup           an arm"
  [[ $out != *btf.note* ]] && pass || fail "keys of notes are shown as they were" "$out"
  run info hostile/models.btfz --json
  expect_json "info --json of two models"
  expect "notes in JSON" 0 '"setup": "a dome"*"notes": {*"setup": "an arm"'
  run info hostile/terminal.btfz
  expect "info of hostile metadata" 0 "x?model 7?  codec           trusted ?31m?0;owned? left?right?  codec           mine?x"
  [ "$(grep -c '^model ' out.txt)" = 1 ] && pass || fail "metadata makes lines of its own" "$out"
  expect_harmless "info of hostile metadata"
  run info --json hostile/terminal.btfz
  expect_json "info --json of hostile metadata"
  expect_harmless "info --json of hostile metadata"
  run encode big.btfd -o "$evil.btfz" --codec fmf -p components=2
  expect "encode to a hostile name" 0 "evil?[31m?x??y.btfz: "
  expect_harmless "encode to a hostile name"

  # All checksums are right, and yet it decodes to NaN: at the first texel, of the finest level and of the level of one texel.
  run verify -t 1 hostile/nan_fine.btfz
  expect "verify of a NaN" 3 "nan_fine.btfz: the value at x 0, y 0, light 0, view 0 of level 0 decodes to something not finite"
  run verify -t 1 hostile/nan_coarse.btfz
  expect "verify of a NaN in the coarsest level" 3 "nan_coarse.btfz: the value at x 0, y 0, light 0, view 0 of level "
  [[ $err != *"of level 0 "* ]] && pass || fail "the coarsest level is another" "$err"
  run verify hostile/terminal.btfz
  expect "verify of the same model without a NaN" 0 "good"
  ;;
*) skip "hostile containers: no FMF codec" ;;
esac
