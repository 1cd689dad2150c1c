#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Checks who includes whom: a layer only itself and lower ones, codecs and tools no internals. Usage: layers.sh SOURCE_DIR
set -eu
cd "$1"
passed=0
failed=0
order=(base io directions dataset dense svd container registry model gpu)
allowed=""
for layer in "${order[@]}"; do
  allowed="$allowed$layer|"
  bad=$(grep -nE '#include "(base|io|directions|dataset|dense|svd|container|registry|model|gpu)/' lib/"$layer"/*.[ch] | grep -vE "#include \"(${allowed%|})/" || true)
  if [ -z "$bad" ]; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    echo "lib/$layer includes a layer above it:"
    echo "$bad"
  fi
done
for folder in codecs formats tools examples; do
  case $folder in
    formats) bad=$(grep -rnE '#include [<"].*btf' formats --include=*.[ch] | grep -vE '<btf/btf_(plugin|codec|half)\.h>|/test_|formats/([a-z0-9_]+)/[a-z0-9_]+\.[ch]:[0-9]+:#include "\2/' | grep -v '"bonn_case.h"' || true) ;;
    codecs) bad=$(grep -rnE '#include [<"].*btf' codecs --include=*.[ch] | grep -vE '<btf/btf_(plugin|codec|half|sampling)\.h>|test_|"btf_test\.h"' || true) ;;
    *) bad=$(grep -rnE '#include "(\.\./)*(lib|base|io|directions|dataset|dense|svd|container|registry|model|gpu)/' $folder --include=*.[ch] || true) ;;
  esac
  if [ -z "$bad" ]; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    echo "$folder reaches inside the library:"
    echo "$bad"
  fi
done
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
