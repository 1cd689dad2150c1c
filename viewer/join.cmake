# SPDX-License-Identifier: MIT
# Joins the viewer's modules, style and page into one page, and that into a C source.
#   cmake -DSOURCE=viewer -DOUTPUT=viewer_template.c -P viewer/join.cmake
# Modules come after those that they import. Imports and exports are whole lines or start one.
set(modules vendor/fzstd.js src/math.js src/ktx2.js src/exports.js src/environment.js src/shapes.js src/shaders.js src/gpu.js
  src/renderer.js src/controls.js src/panel.js src/inspector.js src/main.js)

set(script "")
foreach(module IN LISTS modules)
  file(READ "${SOURCE}/${module}" text)
  string(REGEX REPLACE "\nimport [^\n]*;" "" text "\n${text}")
  string(REPLACE "\nexport " "\n" text "${text}")
  string(APPEND script "${text}")
endforeach()
file(READ "${SOURCE}/style.css" style)
foreach(part script style)
  string(FIND "${${part}}" "</${part}" at)
  if(NOT at EQUAL -1)
    message(FATAL_ERROR "the viewer's ${part} holds its own end tag")
  endif()
endforeach()

file(READ "${SOURCE}/index.html" page)
# Puts a text in place of what lies between two marks.
function(replace_part mark text)
  string(FIND "${page}" "<!-- ${mark} -->" first)
  string(FIND "${page}" "<!-- /${mark} -->" last)
  if(first EQUAL -1 OR last EQUAL -1)
    message(FATAL_ERROR "viewer/index.html: no part ${mark}")
  endif()
  string(LENGTH "<!-- /${mark} -->" length)
  math(EXPR last "${last} + ${length}")
  string(SUBSTRING "${page}" 0 ${first} before)
  string(SUBSTRING "${page}" ${last} -1 after)
  set(page "${before}${text}${after}" PARENT_SCOPE)
endfunction()
replace_part(style "<style>\n${style}</style>")
replace_part(script "<script type=\"module\">${script}</script>")
if(NOT page MATCHES "<!-- files -->")
  message(FATAL_ERROR "viewer/index.html: no place for the files")
endif()

file(WRITE "${OUTPUT}.html" "${page}")
file(READ "${OUTPUT}.html" bytes HEX)
string(REGEX REPLACE "(................................)" "\\1\n" bytes "${bytes}")
string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1," bytes "${bytes}")
file(WRITE "${OUTPUT}" "/* Made by viewer/join.cmake. */\n#include \"viewer_page.h\"\n\nconst unsigned char viewer_template[] = {\n${bytes}0x00};\n")
