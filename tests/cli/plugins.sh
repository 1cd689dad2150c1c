# SPDX-License-Identifier: MIT
# Codecs that come as modules, and files whose codec is not there.

# Plug-in folders: a module that is none is left out with a note; --quiet keeps silent.
mkdir plugins
printf 'not a module' >plugins/none.so
BTF_PLUGIN_PATH=$work/plugins "$btf" codecs >out.txt 2>err.txt
[ $? = 0 ] && grep -q "none.so" err.txt && pass || fail "a broken module in the plug-in folder" "$(cat err.txt)"
BTF_PLUGIN_PATH=$work/plugins "$btf" codecs --quiet >out.txt 2>err.txt
[ $? = 0 ] && [ ! -s err.txt ] && pass || fail "--quiet" "$(cat err.txt)"

if [ -n "$plugin" ]; then
  run codecs --plugin "$plugin"
  name=$(sed -n 's/^\([a-z0-9._-]*\.[a-z0-9._-]*\): .*/\1/p' out.txt | head -1)
  [ -n "$name" ] && pass || fail "the plug-in's codec is listed" "$out"
  run codecs "$name" --json --plugin "$plugin"
  expect_json "codecs of a plug-in"
  run encode tiny.btfd -o plugged.btfz --codec "$name"
  expect "codec of a plug-in that is not loaded" 1 "no codec"
  run encode tiny.btfd -o plugged.btfz --codec "$name" --plugin "$plugin"
  expect "encode with a plug-in" 0 "plugged.btfz"
  run verify plugged.btfz --plugin "$plugin"
  expect "verify with the plug-in" 0 "good"
  for options in --list "-o x"; do
    run export plugged.btfz $options --plugin "$plugin"
    expect "export $options of a codec without layouts" 5 "exports nothing for a GPU"
  done
  run info plugged.btfz
  expect "info without the codec" 0 "$name"
  grep -q "no such codec" out.txt && pass || fail "info says that the codec is missing" "$out"
  run info --json plugged.btfz
  expect_json "info --json without the codec"
  for command in verify eval fetch bench; do
    run $command plugged.btfz </dev/null
    expect "$command without the codec" 5 "$name"
  done
  run compare tiny.btfd plugged.btfz
  expect "compare without the codec" 5 "$name"
  # A codec that cannot be found on a relative path, or by a name in the file, is not looked for.
  (cd "$(dirname "$plugin")" && "$btf" verify "$work/plugged.btfz" >/dev/null 2>&1)
  [ $? = 5 ] && pass || fail "a module of the working folder was loaded"
  BTF_PLUGIN_PATH=$(dirname "$plugin") "$btf" verify -q plugged.btfz >out.txt 2>err.txt
  [ $? = 0 ] && pass || fail "the plug-in folder" "$(cat err.txt)"
else
  skip "plug-ins: none given"
fi
