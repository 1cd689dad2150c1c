#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Size and quality of every codec, pinned in quality.csv: the short form of bench/shootout. A row must be there for each
# codec of the build, its bytes within 1 % of what is pinned (zstd differs from version to version) and its PSNR within
# 0.05 dB (kernels of other processors round otherwise, and a fit that takes another turn shows as more).
# Usage: quality.sh BTF [--update]
set -u
btf=$1
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/btf-quality-XXXXXX")
trap 'rm -rf "$work"' EXIT
passed=0
failed=0
# One thread: sums do not depend on the processors, and those of OpenBLAS do not wait for each other.
printf '#!/bin/sh\nexec "%s" "$@" --threads 1\n' "$(realpath "$btf")" >"$work/btf"
chmod +x "$work/btf"

# One line for each row of the file: material, codec, parameters, bytes, PSNR.
measure() {
  local material encodings
  for material in $(tail -n +2 "$here/quality.csv" | cut -d, -f1 | uniq); do
    "$work/btf" synth "${material%%:*}" -o "$work/$material.btfd" --size "${material#*:}" --directions grid:10x4 \
      --seed 1 --quiet || return 1
    encodings=$(awk -F, -v m="$material" '$1 == m { p = $3; gsub(" ", ",", p); print p == "" ? $2 : $2 ":" p }' \
      "$here/quality.csv")
    # shellcheck disable=SC2086
    "$here/../scripts/measure-codecs" "$work/btf" "$work/$material.btfd" "$work/$material" 0 - $encodings 2>/dev/null |
      awk -F '\t' -v m="$material" '{ printf "%s,%s,%s,%d,%.2f\n", m, $1, $2, $3, $6 }' || return 1
  done
}

if ! measure >"$work/now.csv"; then
  echo "FAILED: the materials could not be measured"
  echo "0 passed, 1 failed"
  exit 1
fi
if [ "${2-}" = --update ]; then
  { head -1 "$here/quality.csv"; cat "$work/now.csv"; } >"$work/new.csv"
  cp "$work/new.csv" "$here/quality.csv"
  exit 0
fi
while IFS=, read -r material codec parameters bytes psnr; do
  row="$material,$codec,$parameters"
  now=$(grep -F -- "$row," "$work/now.csv" | head -1)
  if awk -F, -v n="$now" -v bytes="$bytes" -v psnr="$psnr" 'BEGIN { split(n, f, ",")
      d = f[4] - bytes; e = f[5] - psnr
      exit !(f[4] > 0 && d * d <= 1e-4 * bytes * bytes && e * e <= 0.05001 * 0.05001) }'; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    echo "FAILED: pinned $row,$bytes,$psnr"
    echo "        now    ${now:-nothing}"
  fi
done < <(tail -n +2 "$here/quality.csv")
for codec in $("$btf" codecs --json | grep -o '"id": *"[^"]*"' | sed 's/.*: *"//; s/"//'); do
  if cut -d, -f2 "$here/quality.csv" | grep -qx -- "$codec"; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    echo "FAILED: quality.csv has no row of $codec"
  fi
done
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
