# Defines OpenBLAS_LAPACKE::lapacke: LAPACKE and OpenBLAS with their C headers.
find_path(OpenBLAS_INCLUDE_DIR cblas.h PATH_SUFFIXES openblas openblas-pthread
  HINTS /usr/include/${CMAKE_LIBRARY_ARCHITECTURE}/openblas-pthread)
find_path(LAPACKE_INCLUDE_DIR lapacke.h PATH_SUFFIXES lapacke openblas)
find_library(OpenBLAS_LIBRARY NAMES openblas PATH_SUFFIXES openblas-pthread)
find_library(LAPACKE_LIBRARY NAMES lapacke)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(OpenBLAS_LAPACKE
  REQUIRED_VARS OpenBLAS_LIBRARY LAPACKE_LIBRARY OpenBLAS_INCLUDE_DIR LAPACKE_INCLUDE_DIR)
if(OpenBLAS_LAPACKE_FOUND AND NOT TARGET OpenBLAS_LAPACKE::lapacke)
  add_library(OpenBLAS_LAPACKE::lapacke INTERFACE IMPORTED)
  set_target_properties(OpenBLAS_LAPACKE::lapacke PROPERTIES
    INTERFACE_INCLUDE_DIRECTORIES "${OpenBLAS_INCLUDE_DIR};${LAPACKE_INCLUDE_DIR}"
    INTERFACE_LINK_LIBRARIES "${LAPACKE_LIBRARY};${OpenBLAS_LIBRARY}")
endif()
mark_as_advanced(OpenBLAS_INCLUDE_DIR LAPACKE_INCLUDE_DIR OpenBLAS_LIBRARY LAPACKE_LIBRARY)
