# The few OpenCV modules the product uses, from Debian's per-module -dev packages (libopencv-dev, which
# carries the OpenCVConfig.cmake, would bring a hundred packages the appliance has no use for).
# Defines omnihdr::opencv_core, _imgproc, _imgcodecs.
find_path(OpenCVModules_INCLUDE_DIR opencv2/core.hpp PATH_SUFFIXES opencv4)
set(OpenCVModules_FOUND_ALL TRUE)
foreach(module core imgproc imgcodecs)
  find_library(OpenCVModules_${module}_LIBRARY opencv_${module})
  if(OpenCVModules_INCLUDE_DIR AND OpenCVModules_${module}_LIBRARY AND NOT TARGET omnihdr::opencv_${module})
    add_library(omnihdr::opencv_${module} UNKNOWN IMPORTED)
    set_target_properties(omnihdr::opencv_${module} PROPERTIES
      IMPORTED_LOCATION "${OpenCVModules_${module}_LIBRARY}"
      INTERFACE_SYSTEM_INCLUDE_DIRECTORIES "${OpenCVModules_INCLUDE_DIR}"
      INTERFACE_INCLUDE_DIRECTORIES "${OpenCVModules_INCLUDE_DIR}")
  endif()
endforeach()
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(OpenCVModules REQUIRED_VARS OpenCVModules_INCLUDE_DIR
  OpenCVModules_core_LIBRARY OpenCVModules_imgproc_LIBRARY OpenCVModules_imgcodecs_LIBRARY)
