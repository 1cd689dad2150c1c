# SPDX-License-Identifier: MIT
# Functions that the folders' CMakeLists use.

add_library(libbtf_flags INTERFACE)
target_include_directories(libbtf_flags INTERFACE "${PROJECT_SOURCE_DIR}/include")
target_compile_options(libbtf_flags INTERFACE
  -std=c11 -Wall -Wextra -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Wpointer-arith -Wvla
  -ffp-contract=off -fno-math-errno -fno-trapping-math
  $<$<BOOL:${LIBBTF_WERROR}>:-Werror>)
target_compile_definitions(libbtf_flags INTERFACE _GNU_SOURCE)
if(LIBBTF_SANITIZE)
  target_compile_options(libbtf_flags INTERFACE -fsanitize=${LIBBTF_SANITIZE} -fno-omit-frame-pointer -g
    -fno-sanitize-recover=all)
  target_link_options(libbtf_flags INTERFACE -fsanitize=${LIBBTF_SANITIZE})
endif()

set_property(GLOBAL PROPERTY libbtf_layers "")
set_property(GLOBAL PROPERTY libbtf_static_codecs "")

# libbtf_layer(NAME sources...): one layer of the library as an object library btf_layer_NAME.
function(libbtf_layer name)
  add_library(btf_layer_${name} OBJECT ${ARGN})
  target_link_libraries(btf_layer_${name} PRIVATE libbtf_flags)
  target_include_directories(btf_layer_${name} PRIVATE "${PROJECT_SOURCE_DIR}/lib")
  set_target_properties(btf_layer_${name} PROPERTIES POSITION_INDEPENDENT_CODE ON C_VISIBILITY_PRESET hidden)
  set_property(GLOBAL APPEND PROPERTY libbtf_layers btf_layer_${name})
endfunction()

# libbtf_codec(NAME sources...): a codec folder; LIBBTF_CODEC_<NAME> is STATIC, MODULE or OFF. The folder's codec.c
# defines `const btf_codec_vtbl btf_codec_NAME`.
function(libbtf_codec name)
  string(TOUPPER ${name} upper)
  set(LIBBTF_CODEC_${upper} STATIC CACHE STRING "Codec ${name}: STATIC, MODULE or OFF")
  set_property(CACHE LIBBTF_CODEC_${upper} PROPERTY STRINGS STATIC MODULE OFF)
  set(mode ${LIBBTF_CODEC_${upper}})
  if(mode STREQUAL "STATIC")
    add_library(btf_codec_${name} OBJECT ${ARGN})
    set_property(GLOBAL APPEND PROPERTY libbtf_layers btf_codec_${name})
    set_property(GLOBAL APPEND PROPERTY libbtf_static_codecs ${name})
  elseif(mode STREQUAL "MODULE")
    configure_file("${PROJECT_SOURCE_DIR}/cmake/module_entry.c.in" module_entry_${name}.c @ONLY)
    add_library(btf_codec_${name} MODULE ${ARGN} "${CMAKE_CURRENT_BINARY_DIR}/module_entry_${name}.c")
    set_target_properties(btf_codec_${name} PROPERTIES PREFIX "" OUTPUT_NAME "btf_${name}"
      LIBRARY_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/plugins")
    target_link_libraries(btf_codec_${name} PRIVATE m)
    set_property(GLOBAL APPEND PROPERTY libbtf_codec_modules btf_codec_${name})
  elseif(NOT mode STREQUAL "OFF")
    message(FATAL_ERROR "LIBBTF_CODEC_${upper} is \"${mode}\"; it takes STATIC, MODULE or OFF")
  endif()
  if(TARGET btf_codec_${name})
    target_link_libraries(btf_codec_${name} PRIVATE libbtf_flags)
    if(LIBBTF_FIT)
      target_compile_definitions(btf_codec_${name} PRIVATE LIBBTF_FIT) # without it the codec must not offer to fit
    endif()
    set_target_properties(btf_codec_${name} PROPERTIES POSITION_INDEPENDENT_CODE ON C_VISIBILITY_PRESET hidden)
  endif()
endfunction()

# libbtf_finish_library(): the table of built-in codecs, then the shared and the static library from all layers.
function(libbtf_finish_library)
  get_property(codecs GLOBAL PROPERTY libbtf_static_codecs)
  set(declarations "")
  set(entries "")
  foreach(codec IN LISTS codecs)
    string(APPEND declarations "extern const btf_codec_vtbl btf_codec_${codec};\n")
    string(APPEND entries "&btf_codec_${codec}, ")
  endforeach()
  configure_file("${PROJECT_SOURCE_DIR}/cmake/builtin_codecs.c.in" "${PROJECT_BINARY_DIR}/builtin_codecs.c" @ONLY)
  libbtf_layer(builtin_codecs "${PROJECT_BINARY_DIR}/builtin_codecs.c")

  get_property(layers GLOBAL PROPERTY libbtf_layers)
  set(objects "")
  foreach(layer IN LISTS layers)
    list(APPEND objects $<TARGET_OBJECTS:${layer}>)
  endforeach()

  set(private_libraries Zstd::zstd Threads::Threads m ${CMAKE_DL_LIBS})
  if(LIBBTF_FIT)
    list(APPEND private_libraries OpenBLAS_LAPACKE::lapacke)
  endif()

  add_library(btf_shared SHARED ${objects})
  add_library(btf_static STATIC ${objects})
  set(map "${PROJECT_SOURCE_DIR}/lib/libbtf.map")
  target_link_options(btf_shared PRIVATE "LINKER:--version-script=${map}")
  if(NOT LIBBTF_SANITIZE) # clang leaves the sanitizer's runtime to the program
    target_link_options(btf_shared PRIVATE "LINKER:--no-undefined")
  endif()
  set_target_properties(btf_shared PROPERTIES LINK_DEPENDS "${map}" VERSION ${PROJECT_VERSION}
    SOVERSION ${LIBBTF_ABI} EXPORT_NAME btf_shared)
  set_target_properties(btf_static PROPERTIES EXPORT_NAME btf_static)
  foreach(target btf_shared btf_static)
    set_target_properties(${target} PROPERTIES OUTPUT_NAME ${LIBBTF_OUTPUT_NAME} LINKER_LANGUAGE C)
    target_include_directories(${target} PUBLIC
      $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
    target_link_libraries(${target} PRIVATE ${private_libraries})
    if(LIBBTF_SANITIZE)
      target_link_options(${target} PUBLIC -fsanitize=${LIBBTF_SANITIZE})
    endif()
  endforeach()
  target_compile_definitions(btf_static INTERFACE LIBBTF_STATIC)
  add_library(libbtf::btf_shared ALIAS btf_shared)
  add_library(libbtf::btf_static ALIAS btf_static)
  if(BUILD_SHARED_LIBS)
    add_library(libbtf::btf ALIAS btf_shared)
  else()
    add_library(libbtf::btf ALIAS btf_static)
  endif()
endfunction()

# libbtf_format(NAME sources...): a folder of formats/; LIBBTF_FORMAT_<NAME> is ON or OFF. The folder's format.c defines
# `const btf_format_vtbl btf_format_NAME`.
function(libbtf_format name)
  string(TOUPPER ${name} upper)
  option(LIBBTF_FORMAT_${upper} "Reader of measured data ${name}" ON)
  if(LIBBTF_FORMAT_${upper})
    add_library(btf_format_${name} OBJECT ${ARGN})
    set_property(GLOBAL APPEND PROPERTY libbtf_formats ${name})
  endif()
endfunction()

# libbtf_format_package(NAME package target module debian): a library that the folder's sources need: the CMake package, its
# target, its name for pkg-config and its package in Debian. One that other targets link comes before them.
function(libbtf_format_package name package target module debian)
  string(TOUPPER ${name} upper)
  if(NOT TARGET ${target})
    find_package(${package} QUIET)
    if(NOT TARGET ${target})
      message(FATAL_ERROR "${package} (${debian}) is needed for the format ${name}; -DLIBBTF_FORMAT_${upper}=OFF goes without")
    endif()
    set_target_properties(${target} PROPERTIES IMPORTED_GLOBAL ON) # for whatever links the formats
  endif()
  target_link_libraries(btf_format_${name} PRIVATE ${target})
  get_property(known GLOBAL PROPERTY libbtf_format_packages)
  if(NOT ${package} IN_LIST known)
    set_property(GLOBAL APPEND PROPERTY libbtf_format_packages ${package})
    set_property(GLOBAL APPEND PROPERTY libbtf_format_libraries ${target})
    set_property(GLOBAL APPEND PROPERTY libbtf_format_modules ${module})
  endif()
endfunction()

# libbtf_format_pictures(NAME): the folder's sources decode pictures by source/picture.h.
function(libbtf_format_pictures name)
  libbtf_format_package(${name} ZLIB ZLIB::ZLIB zlib zlib1g-dev)
  libbtf_format_package(${name} PNG PNG::PNG libpng libpng-dev)
  libbtf_format_package(${name} JPEG JPEG::JPEG libjpeg libjpeg-dev)
  if(NOT TARGET btf_formats_picture)
    set(folder "${PROJECT_SOURCE_DIR}/formats/source")
    add_library(btf_formats_picture OBJECT
      "${folder}/picture.c" "${folder}/picture_hdr.c" "${folder}/picture_jpeg.c"
      "${folder}/picture_jpeg_memory.c" "${folder}/picture_png.c")
    target_link_libraries(btf_formats_picture PRIVATE PNG::PNG JPEG::JPEG)
  endif()
endfunction()

# libbtf_finish_formats(OBJECTS...): the library of all formats and its table.
function(libbtf_finish_formats)
  get_property(formats GLOBAL PROPERTY libbtf_formats)
  set(declarations "")
  set(entries "")
  set(parts ${ARGN})
  if(TARGET btf_formats_picture)
    list(APPEND parts btf_formats_picture)
  endif()
  foreach(format IN LISTS formats)
    string(APPEND declarations "extern const btf_format_vtbl btf_format_${format};\n")
    string(APPEND entries "&btf_format_${format}, ")
    list(APPEND parts btf_format_${format})
  endforeach()
  configure_file("${PROJECT_SOURCE_DIR}/cmake/formats_register.c.in" "${PROJECT_BINARY_DIR}/formats_register.c" @ONLY)
  add_library(btf_formats_register OBJECT "${PROJECT_BINARY_DIR}/formats_register.c")
  list(APPEND parts btf_formats_register)
  set(objects "")
  foreach(part IN LISTS parts)
    target_link_libraries(${part} PRIVATE libbtf_flags)
    target_include_directories(${part} PRIVATE "${PROJECT_SOURCE_DIR}/formats")
    set_target_properties(${part} PROPERTIES POSITION_INDEPENDENT_CODE ON C_VISIBILITY_PRESET hidden)
    list(APPEND objects $<TARGET_OBJECTS:${part}>)
  endforeach()
  add_library(btf_formats ${objects})
  set_target_properties(btf_formats PROPERTIES OUTPUT_NAME btfformats LINKER_LANGUAGE C VERSION ${PROJECT_VERSION}
    SOVERSION ${LIBBTF_ABI} EXPORT_NAME formats)
  target_include_directories(btf_formats PUBLIC
    $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
  get_property(libraries GLOBAL PROPERTY libbtf_format_libraries)
  target_link_libraries(btf_formats PUBLIC libbtf::btf PRIVATE m ${libraries})
  if(LIBBTF_SANITIZE)
    target_link_options(btf_formats PUBLIC -fsanitize=${LIBBTF_SANITIZE})
  endif()
  add_library(libbtf::formats ALIAS btf_formats)
endfunction()
