# Language settings and the functions every folder uses to declare its one target.
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "Build type" FORCE)
endif()
set(CMAKE_CXX_FLAGS_RELEASE "-O3 -DNDEBUG")

find_program(CCACHE_PROGRAM ccache)
if(CCACHE_PROGRAM AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  set(CMAKE_CXX_COMPILER_LAUNCHER "${CCACHE_PROGRAM}")
endif()

find_package(Threads REQUIRED)
find_package(PkgConfig REQUIRED)
find_package(fmt REQUIRED)
find_package(TBB REQUIRED)
find_package(OpenEXR REQUIRED)
find_package(OpenCVModules REQUIRED)
if(OMNIHDR_TESTS)
  find_package(Ceres REQUIRED)
endif()
pkg_check_modules(EIGEN3 REQUIRED IMPORTED_TARGET eigen3)

add_library(omnihdr_flags INTERFACE)
target_compile_options(omnihdr_flags INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Wold-style-cast -Wcast-qual
  -Woverloaded-virtual -Wformat=2 -Wimplicit-fallthrough -Wno-psabi
  # Sums in the order written: the same bytes whatever the vector width of the loop's remainder.
  -fno-math-errno -fno-trapping-math)
if(OMNIHDR_WERROR)
  target_compile_options(omnihdr_flags INTERFACE -Werror)
endif()
if(OMNIHDR_SANITIZE)
  # The product's own code is what is checked for undefined behaviour; in the tests' it would double the
  # time to compile. (An option of the tests' own would come before this one and be overruled.)
  string(REPLACE ",undefined" "" sanitize_tests "${OMNIHDR_SANITIZE}")
  string(REPLACE "," "$<COMMA>" sanitize "${OMNIHDR_SANITIZE}")
  target_compile_options(omnihdr_flags INTERFACE
    -fsanitize=$<IF:$<BOOL:$<TARGET_PROPERTY:OMNIHDR_IS_TEST>>,${sanitize_tests},${sanitize}>
    -fno-sanitize-recover=all -fno-omit-frame-pointer)
  target_link_options(omnihdr_flags INTERFACE -fsanitize=${OMNIHDR_SANITIZE})
  if(OMNIHDR_SANITIZE MATCHES "undefined" AND CMAKE_CXX_COMPILER_ID MATCHES "Clang")
    target_compile_options(omnihdr_flags INTERFACE
      "-fsanitize-ignorelist=${PROJECT_SOURCE_DIR}/scripts/cmake/sanitizer_ignorelist.txt")
  endif()
endif()
target_include_directories(omnihdr_flags INTERFACE "${PROJECT_SOURCE_DIR}")
target_compile_definitions(omnihdr_flags INTERFACE OMNIHDR_VERSION="${PROJECT_VERSION}")

# omnihdr_unity(target): compiles the target's files some at a time as one unit. Most of the time of
# tests and commands goes into the same few large headers (GoogleTest, CLI11, JSON) and what they instantiate.
# Files of one target therefore keep their local names apart: a test's are in a namespace of its own.
option(OMNIHDR_UNITY "Compile tests and commands several files at a time" ON)
function(omnihdr_unity target)
  if(OMNIHDR_UNITY)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 8)
  endif()
endfunction()

# omnihdr_unoptimised_under_sanitizers(target): for code without heavy loops, half the time to compile.
function(omnihdr_unoptimised_under_sanitizers target)
  if(OMNIHDR_SANITIZE)
    target_compile_options(${target} PRIVATE -O0)
  endif()
endfunction()

# omnihdr_library(core_base DEPS fmt::fmt): one static library from every .cc file of the calling
# folder (sub-folders excluded), linked PUBLIC to DEPS and PRIVATE to PRIVATE_DEPS. A folder without
# a .cc file becomes a header-only target. UNITY: see omnihdr_unity.
# GLUE: see omnihdr_unoptimised_under_sanitizers.
# COMMANDS: glue that is little optimised in Release, too (a third less to compile).
function(omnihdr_library name)
  cmake_parse_arguments(ARG "UNITY;GLUE;COMMANDS" "" "DEPS;PRIVATE_DEPS;EXCLUDE" ${ARGN})
  file(GLOB sources CONFIGURE_DEPENDS *.cc)
  foreach(file IN LISTS ARG_EXCLUDE)
    list(REMOVE_ITEM sources "${CMAKE_CURRENT_SOURCE_DIR}/${file}")
  endforeach()
  if(sources)
    add_library(${name} STATIC ${sources})
    target_link_libraries(${name} PUBLIC omnihdr_flags ${ARG_DEPS} PRIVATE ${ARG_PRIVATE_DEPS})
    if(ARG_UNITY)
      omnihdr_unity(${name})
    endif()
    if(ARG_GLUE OR ARG_COMMANDS)
      omnihdr_unoptimised_under_sanitizers(${name})
    endif()
    if(ARG_COMMANDS)
      target_compile_options(${name} PRIVATE $<$<CONFIG:Release>:-O1>)
    endif()
  else()
    add_library(${name} INTERFACE)
    target_link_libraries(${name} INTERFACE omnihdr_flags ${ARG_DEPS})
  endif()
endfunction()

# omnihdr_test(unit_core_base LABELS fast DEPS core_base): one GoogleTest program from every
# *_test.cc of the calling folder, each case a ctest test; with OMNIHDR_TEST_SHARDS each program is that
# many tests (starting a sanitized program takes longer than most cases), with SHARDS one whose cases
# share what takes long to make: always that many.
set(OMNIHDR_TEST_SHARDS "0" CACHE STRING "Run a test program in this many parts; 0: every case alone")
function(omnihdr_test name)
  cmake_parse_arguments(ARG "" "TIMEOUT;SHARDS" "DEPS;LABELS" ${ARGN})
  file(GLOB sources CONFIGURE_DEPENDS *_test.cc)
  if(NOT sources)
    return()
  endif()
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 120)
  endif()
  if(OMNIHDR_SANITIZE)
    math(EXPR ARG_TIMEOUT "5 * ${ARG_TIMEOUT}")  # seconds; sanitized code is that much slower
  endif()
  add_executable(${name} ${sources})
  target_link_libraries(${name} PRIVATE omnihdr_flags ${ARG_DEPS} GTest::gmock GTest::gtest_main)
  omnihdr_unity(${name})
  set_target_properties(${name} PROPERTIES OMNIHDR_IS_TEST ON)
  omnihdr_unoptimised_under_sanitizers(${name})
  # The tree's place is told only to programs that ask: ccache shares all other objects between checkouts.
  foreach(source IN LISTS sources)
    file(STRINGS "${source}" asks REGEX "OMNIHDR_SOURCE_DIR" LIMIT_COUNT 1)
    if(asks)
      target_compile_definitions(${name} PRIVATE OMNIHDR_SOURCE_DIR="${PROJECT_SOURCE_DIR}")
      break()
    endif()
  endforeach()
  # One target that builds every unit test (what the sanitizer build needs).
  if("unit" IN_LIST ARG_LABELS)
    if(NOT TARGET unit_tests)
      add_custom_target(unit_tests)
    endif()
    add_dependencies(unit_tests ${name})
  else()
    target_compile_definitions(${name} PRIVATE OMNIHDR_BINARY_DIR="${PROJECT_BINARY_DIR}")
  endif()
  if(NOT ARG_SHARDS)
    set(ARG_SHARDS ${OMNIHDR_TEST_SHARDS})
  endif()
  if(ARG_SHARDS)
    math(EXPR last "${ARG_SHARDS} - 1")
    math(EXPR ARG_TIMEOUT "10 * ${ARG_TIMEOUT}")  # of many cases
    foreach(shard RANGE ${last})
      add_test(NAME ${name}/${shard} COMMAND ${name} --gtest_brief=1)
      set(environment "GTEST_TOTAL_SHARDS=${ARG_SHARDS}" "GTEST_SHARD_INDEX=${shard}")
      if(OMNIHDR_SANITIZE MATCHES "thread")
        list(APPEND environment
          "TSAN_OPTIONS=suppressions=${PROJECT_SOURCE_DIR}/scripts/cmake/tsan_suppressions.txt")
      endif()
      set_tests_properties(${name}/${shard} PROPERTIES LABELS "${ARG_LABELS}" TIMEOUT ${ARG_TIMEOUT}
        ENVIRONMENT "${environment}")
    endforeach()
    return()
  endif()
  gtest_discover_tests(${name} DISCOVERY_MODE PRE_TEST DISCOVERY_TIMEOUT 60)
  # Not as PROPERTIES of the call above: there a list of labels falls apart and swallows the timeout.
  set(properties "${CMAKE_CURRENT_BINARY_DIR}/${name}_properties.cmake")
  file(WRITE "${properties}" "if(${name}_TESTS)
  set_tests_properties(\${${name}_TESTS} PROPERTIES LABELS \"${ARG_LABELS}\" TIMEOUT ${ARG_TIMEOUT})
endif()
")
  set_property(DIRECTORY APPEND PROPERTY TEST_INCLUDE_FILES "${properties}")
endfunction()

# omnihdr_fuzz(journal_fuzz DEPS core_session): one libFuzzer program from NAME.cc of the calling
# folder; its seeds are in tests/fuzz/corpus/NAME without the "_fuzz". The libraries named are what is
# fuzzed: they alone report their branches to the fuzzer. `fuzz_targets` builds them all.
function(omnihdr_fuzz name)
  cmake_parse_arguments(ARG "" "" "DEPS" ${ARGN})
  add_executable(${name} ${name}.cc)
  target_link_libraries(${name} PRIVATE omnihdr_flags ${ARG_DEPS})
  target_link_options(${name} PRIVATE -fsanitize=fuzzer)
  foreach(library IN LISTS ARG_DEPS)
    get_target_property(options ${library} COMPILE_OPTIONS)
    if(NOT options MATCHES "fuzzer-no-link")
      target_compile_options(${library} PRIVATE -fsanitize=fuzzer-no-link)
    endif()
  endforeach()
  if(NOT TARGET fuzz_targets)
    add_custom_target(fuzz_targets)
  endif()
  add_dependencies(fuzz_targets ${name})
endfunction()
