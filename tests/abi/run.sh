#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Checks the binary interface: headers, export map and the built library name the same functions; nothing else leaves
# the library; no name clashes with libbpf or SuiteSparse; abidiff against the committed baseline.
# Usage: run.sh SOURCE_DIR WORK_DIR [--update]
set -eu
source=$1
work=$2
mkdir -p "$work"
passed=0
failed=0
verdict() { # name status
  if [ "$2" = 0 ]; then
    passed=$((passed + 1))
    echo "ok $1"
  else
    failed=$((failed + 1))
    echo "FAILED $1"
  fi
}

# Debug information makes abidw see types, so the library is built anew with it.
cmake -S "$source" -B "$work/build" -DCMAKE_BUILD_TYPE=Debug -DLIBBTF_BUILD_TOOLS=OFF -DLIBBTF_BUILD_TESTS=OFF \
  -DLIBBTF_BUILD_EXAMPLES=OFF -DLIBBTF_BUILD_FORMATS=OFF -DLIBBTF_BUILD_BENCH=OFF -DLIBBTF_INSTALL=OFF >/dev/null
cmake --build "$work/build" --target btf_shared -- -s >/dev/null 2>&1 || cmake --build "$work/build" --target btf_shared >/dev/null
library=$(find "$work/build" -name 'libbtfcore.so.*.*' | head -1)

# Declarations: the text from LIBBTF_API to the first parenthesis ends with the function's name.
# btf_formats.h is of another library.
find "$source/include/btf" -name '*.h' ! -name btf_formats.h -exec cat {} + | grep -v '^ *\*\|^#' | tr '\n' ' ' | sed 's/;/;\n/g' |
  grep -o 'LIBBTF_API[^(;]*(' | grep -o 'btf_[a-z0-9_]*($' | tr -d '(' | LC_ALL=C sort -u >"$work/header"
sed -n '/global:/,/local:/p' "$source/lib/libbtf.map" | grep -o 'btf_[a-z0-9_]*' | LC_ALL=C sort >"$work/map"
nm -D --defined-only "$library" | awk '$2 != "A" { sub(/@.*/, "", $3); print $3 }' | LC_ALL=C sort >"$work/exported"
[ -s "$work/header" ] && diff -u "$work/header" "$work/map" && s=0 || s=1
verdict "headers and export map agree" $s
diff -u "$work/map" "$work/exported" && s=0 || s=1
verdict "export map and library agree" $s
nm -D --defined-only "$library" | awk '$2 != "A" && $3 !~ /@@LIBBTF_[0-9]/ { bad = 1; print } END { exit bad }' && s=0 || s=1
verdict "every symbol carries a version" $s
grep -E '^(btf_order|btf_maxtrans|btf_strongcomp|btf_l_|btf__|btf_ext__|btf_dump__|btf_kind|btf_vlen|btf_array|btf_enum|btf_params|btf_var_secinfos|btf_members)' "$work/exported" && s=1 || s=0
verdict "no name of libbpf or SuiteSparse" $s
grep -hE '^#define (BTF_MAGIC|BTF_VERSION|BTF_KIND|BTF_INT_|BTF_INFO|BTF_MAX_|BTF_MEMBER)' "$source"/include/btf/*.h && s=1 || s=0
verdict "no macro of <linux/btf.h>" $s

if command -v abidw >/dev/null; then
  abidw --no-corpus-path --no-comp-dir-path --no-show-locs --short-locs --headers-dir "$source/include" \
    --out-file "$work/now.abi" "$library"
  if [ "${3-}" = --update ]; then cp "$work/now.abi" "$source/tests/abi/baseline.abi"; fi
  abidiff --no-show-locs --headers-dir2 "$source/include" "$source/tests/abi/baseline.abi" "$library" && s=0 || s=1
  verdict "abidiff against the baseline" $s
else
  echo "abidw is not installed: the baseline was not compared"
fi
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
