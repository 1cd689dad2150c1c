#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Golden tests of the btf command. Usage: run.sh BTF TESTS_CLI_DIR HOSTILE [PLUGIN]: the program that writes hostile files,
# or "", and the example plug-in; UPDATE=1 rewrites the recorded help texts. A check that cannot be made here (no python3, no FMF codec) is counted as skipped.
set -u
btf=$1
here=$2
hostile=${3:-}
plugin=${4:-}
work=$(mktemp -d "${TMPDIR:-/tmp}/btf-cli-XXXXXX")
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1
export LC_ALL=C
unset BTF_PLUGIN_PATH
passed=0
failed=0
skipped=0

pass() { passed=$((passed + 1)); }
fail() {
  failed=$((failed + 1))
  echo "FAILED: $1"
  shift
  for line in "$@"; do echo "    $line"; done
}
skip() {
  skipped=$((skipped + 1))
  echo "skipped: $1"
}

# run ARGS...: runs btf, leaves status, out and err.
run() {
  "$btf" "$@" >out.txt 2>err.txt
  status=$?
  out=$(cat out.txt)
  err=$(cat err.txt)
}

# expect NAME STATUS [PATTERN]: checks the last run. A failure has one line "btf: ..." on standard error that holds PATTERN
# (a glob), a success has PATTERN in its output.
expect() {
  local name=$1 wanted=$2 pattern=${3:-}
  if [ "$status" != "$wanted" ]; then
    fail "$name" "status $status instead of $wanted" "out: ${out:0:300}" "err: ${err:0:300}"
    return
  fi
  if [ "$wanted" != 0 ]; then
    if [ "$(wc -l <err.txt)" != 1 ] || [[ $err != "btf: "* ]]; then
      fail "$name" "standard error is not one line that begins with btf:" "err: ${err:0:300}"
    elif [[ $err != *$pattern* ]]; then
      fail "$name" "\"$err\" lacks \"$pattern\""
    else
      pass
    fi
  elif [[ $out != *$pattern* ]]; then
    fail "$name" "output lacks \"$pattern\"" "out: ${out:0:300}"
  else
    pass
  fi
}

# expect_numbers NAME NUMBERS: the output of the last run holds these numbers to 1e-6 relative, which allows for float32
# interpolation (a few times 6e-8 for each of its steps).
expect_numbers() {
  local name=$1 wanted=$2
  if [ "$status" != 0 ]; then
    fail "$name" "status $status" "err: $err"
  elif printf '%s\n' "$out" | tr ' ' '\n' | awk -v wanted="$wanted" '
      BEGIN { n = split(wanted, w, " ") }
      { d = $1 - w[NR]; if (d < 0) d = -d; s = w[NR] < 0 ? -w[NR] : w[NR]; if (NR > n || d > 1e-6 * s + 1e-12) bad = 1 }
      END { exit bad || NR != n }'; then
    pass
  else
    fail "$name" "got $(echo $out)" "expected $wanted"
  fi
}

expect_json() {
  local name=$1
  if [ "$status" != 0 ]; then
    fail "$name" "status $status" "err: $err"
  elif ! command -v python3 >/dev/null; then
    skip "$name: no python3"
  elif python3 -m json.tool <out.txt >/dev/null 2>json.txt; then
    pass
  else
    fail "$name" "$(cat json.txt)"
  fi
}

# leftovers DIR: what is in a folder besides the names given.
leftovers() {
  local folder=$1
  shift
  ls -A "$folder" | grep -vxF -e "${1:-//}" -e "${2:-//}" || true
}

for part in basics values encode export measured convert check plugins pictures robust hostile; do
  # shellcheck source=/dev/null
  . "$here/$part.sh"
done

echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" = 0 ]
