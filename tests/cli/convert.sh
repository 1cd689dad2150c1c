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
  run convert measured.jpg again.btfz -t 2
  cmp -s kept.btfz again.btfz && pass || fail "the name of the output and the threads change the bytes"
  run convert kept.btfz packed.btfz -p storage=f32 -p coding=packed
  expect "convert a container" 0 "packed.btfz: fmf"
  run compare measured.jpg packed.btfz --max-rmse 1e-6
  expect "packed factors" 0 ""
  run convert measured.jpg cosine.btfz --from bonn-btf --from-param cosine=inside
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
  run convert measured.jpg x.btfz --from merl
  expect "the wrong format of IN" 3 "measured.jpg"
  run convert short.jpg x.btfz
  expect "convert a short file" 3 "ends within"
  [ ! -e x.btfz ] && pass || fail "a failed conversion left something behind"
  run convert measured.jpg nowhere/x.btfz
  expect "a place that is not there" 2 "nowhere"
  mkdir folder.btfz
  run convert measured.jpg folder.btfz
  expect "a folder in the place of a container" 2 "is a folder"
  rmdir folder.btfz
fi
run convert measured.jpg
expect "convert without OUT" 1 "argument is missing"
