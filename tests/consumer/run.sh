#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Installs a build to a scratch prefix and builds consumers against it: find_package, pkg-config shared and static,
# add_subdirectory; also after the tree was moved. Usage: run.sh BUILD_DIR SOURCE_DIR
set -eu
build=$1
source=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
passed=0
failed=0
check() { # name command...
  local name=$1
  shift
  if "$@" >"$work/log" 2>&1; then
    passed=$((passed + 1))
    echo "ok $name"
  else
    failed=$((failed + 1))
    echo "FAILED $name"
    cat "$work/log"
  fi
}

cmake --install "$build" --prefix "$work/first" >/dev/null
mv "$work/first" "$work/prefix" # the installed tree must be relocatable
libdir=$(dirname "$(find "$work/prefix" -name 'libbtf.pc')")/..
export PKG_CONFIG_PATH="$libdir/pkgconfig" LD_LIBRARY_PATH="$libdir"

(cd "$work/prefix" && find . -type f -o -type l | grep -v '^\./share/doc/libbtf/\(docs\|examples\)/' | sed 's|^\./||; s|lib/[a-z0-9_]*-linux-gnu[a-z0-9]*/|lib/|; s|targets-[a-z]*\.cmake|targets-CONFIG.cmake|' | LC_ALL=C sort) >"$work/installed"
check "installed files equal the manifest" diff -u "$source/tests/consumer/installed.txt" "$work/installed"

# Every link from one installed page to another leads somewhere, and so do those in the source tree.
check_links() {
  local page target broken=0
  while read -r page; do
    while read -r target; do
      [ -e "$(dirname "$page")/$target" ] || { echo "$page: $target is not there"; broken=1; }
    done < <(grep -o '](\([^)#]*\)' "$page" | sed 's/^](//' | grep -v -e '^[a-z]*:' -e '^$')
  done < <(find "$1" \( -path "$1/build" -o -name node_modules \) -prune -o -name '*.md' -print)
  return $broken
}
check "links of the installed documentation" check_links "$work/prefix/share/doc/libbtf"
check "links of the source tree" check_links "$source"
check "the installed documentation is whole" diff -r -x man "$source/docs" "$work/prefix/share/doc/libbtf/docs"

run_formats() { # FOLDER: the program that links the formats, if the build has them
  [ ! -e "$work/$1/consumer_formats" ] || "$work/$1/consumer_formats"
}

build_package() {
  cmake -S "$source/tests/consumer" -B "$work/package" -DCMAKE_PREFIX_PATH="$work/prefix" &&
    cmake --build "$work/package" && "$work/package/consumer_c" && "$work/package/consumer_static" &&
    "$work/package/consumer_cxx" && run_formats package
}
check "find_package" build_package

# As they are installed, together and each folder alone.
build_examples() {
  local examples=$work/prefix/share/doc/libbtf/examples folder
  for folder in . gl_host plugin; do
    cmake -S "$examples/$folder" -B "$work/examples/$folder" -DCMAKE_PREFIX_PATH="$work/prefix" -DCMAKE_BUILD_TYPE=Release &&
      cmake --build "$work/examples/$folder" || return
  done
  "$work/examples/example_source" "$work/source.btfz" && "$work/examples/example_evaluate" "$work/source.btfz"
}
check "the examples by themselves" build_examples

# shellcheck disable=SC2046
pkg_gl_host() {
  (cd "$work/prefix/share/doc/libbtf/examples/gl_host" &&
    ${CC:-cc} gl_host.c screen.c -o "$work/pkg_gl_host" $(pkg-config --cflags --libs libbtf egl glesv2 libpng) -lm) &&
    "$work/pkg_gl_host" --help
}
if pkg-config --exists egl glesv2 libpng; then check "pkg-config of the example gl_host" pkg_gl_host; fi

# With static libraries by default, so that those of the formats are made too; they are installed for what follows.
build_subdirectory() {
  cmake -S "$source/tests/consumer" -B "$work/sub" -DLIBBTF_SUBDIRECTORY="$source" -DLIBBTF_BUILD_TOOLS=OFF \
    -DBUILD_SHARED_LIBS=OFF -DLIBBTF_INSTALL=ON &&
    cmake --build "$work/sub" && "$work/sub/consumer_c" && "$work/sub/consumer_static" && "$work/sub/consumer_cxx" &&
    run_formats sub
}
check "add_subdirectory" build_subdirectory

build_static_package() {
  cmake --install "$work/sub" --prefix "$work/static" &&
    cmake -S "$source/tests/consumer" -B "$work/static_package" -DCMAKE_PREFIX_PATH="$work/static" &&
    cmake --build "$work/static_package" && "$work/static_package/consumer_c" && run_formats static_package
}
check "find_package of static libraries" build_static_package

# shellcheck disable=SC2046
pkg_static_formats() {
  local folder
  folder=$(dirname "$(find "$work/static" -name libbtf.pc)")
  ${CC:-cc} -std=c99 "$source/tests/consumer/formats.c" -o "$work/pkg_static_formats" \
    $(PKG_CONFIG_PATH=$folder pkg-config --static --cflags --libs libbtf-formats) && "$work/pkg_static_formats" &&
    ! ldd "$work/pkg_static_formats" | grep -q libbtfformats
}
if [ -e "$work/sub/consumer_formats" ]; then check "pkg-config of the static formats" pkg_static_formats; fi

# shellcheck disable=SC2046
pkg_shared() {
  ${CC:-cc} -std=c99 -Wall -Wextra -Wpedantic -Werror "$source/tests/consumer/consumer.c" \
    -o "$work/pkg_shared" $(pkg-config --cflags --libs libbtf) -lm && "$work/pkg_shared" &&
    ldd "$work/pkg_shared" | grep -q libbtfcore.so
}
check "pkg-config shared" pkg_shared

# shellcheck disable=SC2046
pkg_formats() {
  ${CC:-cc} -std=c99 -Wall -Wextra -Wpedantic -Werror "$source/tests/consumer/formats.c" \
    -o "$work/pkg_formats" $(pkg-config --cflags --libs libbtf-formats) && "$work/pkg_formats"
}
if [ -e "$libdir/pkgconfig/libbtf-formats.pc" ]; then check "pkg-config of the formats" pkg_formats; fi

# shellcheck disable=SC2046
pkg_static() {
  ${CC:-cc} -std=c99 -DLIBBTF_STATIC "$source/tests/consumer/consumer.c" -o "$work/pkg_static" $(pkg-config --cflags libbtf) \
    "$(pkg-config --variable=libdir libbtf)/libbtfcore.a" $(pkg-config --static --libs-only-l libbtf | sed 's/-lbtfcore//') &&
    "$work/pkg_static" && ! ldd "$work/pkg_static" | grep -q libbtfcore
}
check "pkg-config static" pkg_static

for header in btf btf_base btf_dataset btf_model btf_format btf_formats btf_io btf_plugin btf_codec btf_half btf_sampling; do
  printf '#include <btf/%s.h>\nint main(void) { return 0; }\n' $header >"$work/one.c"
  check "$header.h alone as C99" ${CC:-cc} -std=c99 -Wall -Wextra -Wpedantic -Wpadded -Werror -fsyntax-only -I"$source/include" "$work/one.c"
  check "$header.h alone as C++11" ${CXX:-c++} -x c++ -std=c++11 -Wall -Wextra -Wpedantic -Werror -fsyntax-only -I"$source/include" "$work/one.c"
done
printf '#include <linux/btf.h>\n#include <btf/btf.h>\n#include <btf/btf_codec.h>\nint main(void) { return 0; }\n' >"$work/one.c"
check "after <linux/btf.h>" ${CC:-cc} -std=c99 -Wall -Werror -fsyntax-only -I"$source/include" "$work/one.c"
printf '#include <btf/btf.h>\n#include <btf/btf_codec.h>\n#include <linux/btf.h>\nint main(void) { return 0; }\n' >"$work/one.c"
check "before <linux/btf.h>" ${CC:-cc} -std=c99 -Wall -Werror -fsyntax-only -I"$source/include" "$work/one.c"

echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
