# SPDX-License-Identifier: MIT
# Install rules, the CMake package and libbtf.pc. Components: runtime, dev, tools, codecs.
include(CMakePackageConfigHelpers)

install(TARGETS btf_shared EXPORT libbtf-targets
  LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT runtime NAMELINK_COMPONENT dev)
install(TARGETS btf_static EXPORT libbtf-targets
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT dev)
if(TARGET btf_formats)
  install(TARGETS btf_formats EXPORT libbtf-targets
    LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT runtime NAMELINK_COMPONENT dev
    ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT dev)
endif()
install(DIRECTORY include/btf DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT dev FILES_MATCHING PATTERN "*.h")
# What the README links to lies beside it, as here.
install(FILES LICENSE README.md CHANGELOG.md CONTRIBUTING.md SECURITY.md DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT dev)
install(DIRECTORY docs examples DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT dev PATTERN man EXCLUDE)
if(TARGET btf)
  install(TARGETS btf RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT tools)
  install(FILES docs/man/btf.1 DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 COMPONENT tools)
endif()
get_property(modules GLOBAL PROPERTY libbtf_codec_modules)
if(modules)
  install(TARGETS ${modules} LIBRARY DESTINATION ${LIBBTF_PLUGIN_DIR} COMPONENT codecs)
endif()

set(format_packages "")
set(pc_formats_requires_private "")
if(TARGET btf_formats)
  get_target_property(formats_type btf_formats TYPE)
  if(formats_type STREQUAL "STATIC_LIBRARY")
    get_property(format_packages GLOBAL PROPERTY libbtf_format_packages)
    list(JOIN format_packages " " format_packages)
  endif()
  get_property(pc_formats_requires_private GLOBAL PROPERTY libbtf_format_modules)
  list(JOIN pc_formats_requires_private " " pc_formats_requires_private)
endif()

set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/libbtf)
install(EXPORT libbtf-targets NAMESPACE libbtf:: DESTINATION ${package_dir} COMPONENT dev)
configure_package_config_file(cmake/libbtfConfig.cmake.in libbtfConfig.cmake INSTALL_DESTINATION ${package_dir})
# Before 1.0 any minor release may change the interface.
write_basic_package_version_file(libbtfConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/libbtfConfig.cmake ${CMAKE_CURRENT_BINARY_DIR}/libbtfConfigVersion.cmake
  cmake/FindZstd.cmake cmake/FindOpenBLAS_LAPACKE.cmake cmake/FindMinizip.cmake
  DESTINATION ${package_dir} COMPONENT dev)

# libbtf.pc finds its prefix from its own place, so that an installed tree can be moved.
file(RELATIVE_PATH pc_prefix "/${CMAKE_INSTALL_LIBDIR}/pkgconfig" "/")
string(REGEX REPLACE "/$" "" pc_prefix "${pc_prefix}")
set(pc_libs_private "-lm -lpthread -ldl")
if(LIBBTF_FIT)
  set(pc_libs_private "-llapacke -lopenblas ${pc_libs_private}")
endif()
configure_file(pkgconfig/libbtf.pc.in libbtf.pc @ONLY)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/libbtf.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig COMPONENT dev)
if(TARGET btf_formats)
  configure_file(pkgconfig/libbtf-formats.pc.in libbtf-formats.pc @ONLY)
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/libbtf-formats.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig COMPONENT dev)
endif()
