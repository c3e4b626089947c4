# WebAssembly with Debian's clang, C library and C++ library. Without INCISE_WASM there is nothing of it.
option(INCISE_WASM "Build the session as a module of WebAssembly, and the page without a server" OFF)
if(NOT INCISE_WASM)
  return()
endif()
find_program(WASM_CXX clang++-16)
find_program(WASM_LD wasm-ld-16)
find_path(WASM_CXX_INCLUDE vector PATHS /usr/lib/llvm-16/include/wasm32-wasi/c++/v1 NO_DEFAULT_PATH)
find_path(WASM_C_INCLUDE wasi/api.h PATHS /usr/include/wasm32-wasi NO_DEFAULT_PATH)
find_file(WASM_LIBCXX libc++.a PATHS /usr/lib/llvm-16/lib/wasm32-wasi NO_DEFAULT_PATH)
find_file(WASM_LIBCXXABI libc++abi.a PATHS /usr/lib/llvm-16/lib/wasm32-wasi NO_DEFAULT_PATH)
find_file(WASM_LIBC libc.a PATHS /usr/lib/wasm32-wasi NO_DEFAULT_PATH)
find_file(WASM_BUILTINS libclang_rt.builtins-wasm32.a PATHS /usr/lib/llvm-16/lib/clang/16/lib/wasi NO_DEFAULT_PATH)
foreach(part WASM_CXX WASM_LD WASM_CXX_INCLUDE WASM_C_INCLUDE WASM_LIBCXX WASM_LIBCXXABI WASM_LIBC WASM_BUILTINS)
  if(NOT ${part})
    message(FATAL_ERROR "The page without a server needs the section wasm of config/packages.txt (${part} was not found): "
      "./dev build installs it; -DINCISE_WASM=OFF builds without that page")
  endif()
endforeach()

# Other libraries' headers, without the C library's beside them.
set(wasm_dir ${CMAKE_BINARY_DIR}/wasm)
file(MAKE_DIRECTORY ${wasm_dir}/include ${wasm_dir}/units)
get_target_property(json_include nlohmann_json::nlohmann_json INTERFACE_INCLUDE_DIRECTORIES)
list(GET json_include 0 json_include)
file(CREATE_LINK ${json_include}/nlohmann ${wasm_dir}/include/nlohmann SYMBOLIC)
file(CREATE_LINK ${FLATBUFFERS_INCLUDE_DIR}/flatbuffers ${wasm_dir}/include/flatbuffers SYMBOLIC)

# -ffp-contract=off for the same reason as everywhere (../../CMakeLists.txt). Sizes of 64 bits become 32 here, and all of them are checked
# against what is there before.
set(wasm_options --target=wasm32-wasi -nostdlibinc -isystem ${WASM_CXX_INCLUDE} -isystem ${WASM_C_INCLUDE}
  -isystem ${wasm_dir}/include -isystem ${CMAKE_BINARY_DIR}/generated -I ${CMAKE_SOURCE_DIR} -std=c++20 -O3 -mbulk-memory -mnontrapping-fptoint -msimd128 -fwasm-exceptions
  -ffp-contract=off -Wall -Wextra -Wshadow -Wconversion -Wno-sign-conversion -Wno-shorten-64-to-32
  -DJSON_HAS_FILESYSTEM=0 -DJSON_HAS_EXPERIMENTAL_FILESYSTEM=0)
set(wasm_launcher)
if(CCACHE)
  set(wasm_launcher ${CCACHE})
endif()

# wasm_unit(NAME SOURCE ...): ${wasm_dir}/NAME.o, one compilation for all of the sources, since their common headers are most of the work.
function(wasm_unit name)
  set(unit ${wasm_dir}/units/${name}.cpp)
  list(TRANSFORM ARGN REPLACE "(.+)" "#include \"\\1\"\n" OUTPUT_VARIABLE includes)
  string(JOIN "" text ${includes})
  file(CONFIGURE OUTPUT ${unit} CONTENT "${text}" @ONLY)
  add_custom_command(
    OUTPUT ${wasm_dir}/${name}.o
    COMMAND ${wasm_launcher} ${WASM_CXX} ${wasm_options} -MD -MF ${wasm_dir}/${name}.d -MT ${wasm_dir}/${name}.o
      -c ${unit} -o ${wasm_dir}/${name}.o
    DEPENDS ${unit} ${CMAKE_BINARY_DIR}/generated/protocol/incise_generated.h
    DEPFILE ${wasm_dir}/${name}.d
    COMMENT "WebAssembly: ${name}"
    VERBATIM)
endfunction()

# wasm_module(NAME UNIT ...): ${wasm_dir}/NAME.wasm of these units and the runtime for exceptions. It has no main(): its _initialize() runs the
# constructors.
function(wasm_module name)
  list(TRANSFORM ARGN REPLACE "(.+)" "${wasm_dir}/\\1.o" OUTPUT_VARIABLE objects)
  cmake_path(REPLACE_FILENAME WASM_LIBC crt1-reactor.o OUTPUT_VARIABLE reactor)
  set(libraries ${WASM_LIBCXX} ${WASM_LIBCXXABI} ${WASM_LIBC} ${WASM_BUILTINS})
  add_custom_command(
    OUTPUT ${wasm_dir}/${name}.wasm
    COMMAND ${WASM_LD} --entry=_initialize -z stack-size=1048576 --stack-first --strip-all -o ${wasm_dir}/${name}.wasm
      ${reactor} ${objects} ${libraries}
    DEPENDS ${objects} ${libraries}
    COMMENT "WebAssembly: linking ${name}"
    VERBATIM)
  add_custom_target(wasm_${name} ALL DEPENDS ${wasm_dir}/${name}.wasm)
endfunction()
