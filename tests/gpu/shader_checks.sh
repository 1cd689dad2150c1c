# SPDX-License-Identifier: MIT
# shader_checks.sh TOOL...: sourced by suites that compile shaders. Ends them with 77 where a tool is missing; makes the
# folder $work, and counts in $passed and $failed.
for tool in "$@"; do
  command -v "$tool" >/dev/null || { echo "skipped: no $tool"; exit 77; }
done
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
passed=0
failed=0

# check NAME COMMAND...: the command must succeed and say nothing of warnings.
check() {
  local name=$1
  shift
  if "$@" >"$work/out.txt" 2>&1 && ! grep -qi warning "$work/out.txt"; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    echo "FAILED: $name"
    head -5 "$work/out.txt"
    return 1
  fi
}

finish() {
  echo "$passed passed, $failed failed"
  [ "$failed" = 0 ]
}
