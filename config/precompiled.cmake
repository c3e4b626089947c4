# Precompiled headers for the tests and for what uses Asio and Beast: those units spend a third of their time on these
# headers. They hold the standard library and other libraries only, so that no change of ours makes them be compiled
# again. They save time and nothing else: each source includes what it uses, and the preset lint compiles without them.
#
# incise_precompiled(SET TARGET ...): the targets' C++ sources begin with the set `test` (test programs) or `net` (libraries).
if(CMAKE_DISABLE_PRECOMPILE_HEADERS)
  function(incise_precompiled)
  endfunction()
  return()
endif()

set(std_headers <algorithm> <array> <atomic> <chrono> <cmath> <cstdint> <deque> <fstream> <functional> <limits> <map>
  <memory> <mutex> <optional> <set> <span> <sstream> <stdexcept> <string> <string_view> <thread> <utility> <variant> <vector>)
set(test_headers <gtest/gtest.h> <filesystem> ${std_headers})
set(net_headers ${std_headers} <boost/asio/as_tuple.hpp> <boost/asio/awaitable.hpp> <boost/asio/co_spawn.hpp>
  <boost/asio/detached.hpp> <boost/asio/io_context.hpp> <boost/asio/ip/tcp.hpp> <boost/asio/post.hpp>
  <boost/asio/ssl/context.hpp> <boost/asio/steady_timer.hpp> <boost/asio/use_awaitable.hpp> <boost/asio/write.hpp>
  <boost/beast/core/flat_buffer.hpp> <boost/beast/core/tcp_stream.hpp> <boost/beast/http/message.hpp>
  <boost/beast/http/string_body.hpp> <boost/beast/ssl/ssl_stream.hpp>)

# With these, ccache knows a precompiled header by its content; CMakeLists.txt sets what else it needs.
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  set(precompiled_options -fpch-preprocess)
else()
  set(precompiled_options "SHELL:-Xclang -fno-pch-timestamp")
endif()

file(WRITE ${CMAKE_BINARY_DIR}/precompiled/empty.cpp "")
foreach(set test net)
  add_library(precompiled_${set} OBJECT EXCLUDE_FROM_ALL ${CMAKE_BINARY_DIR}/precompiled/empty.cpp)
  target_precompile_headers(precompiled_${set} PRIVATE ${${set}_headers})
  target_compile_options(precompiled_${set} PRIVATE ${precompiled_options})
endforeach()
# A set must be compiled with the options and macros of its users, else the compiler warns and does without: programs are
# -fPIE, and tests have an optimisation of their own.
set_target_properties(precompiled_test PROPERTIES POSITION_INDEPENDENT_CODE OFF)
target_compile_options(precompiled_test PRIVATE -fPIE ${INCISE_TEST_OPTIONS})
target_compile_definitions(precompiled_test PRIVATE GTEST_HAS_PTHREAD=1)
target_compile_definitions(precompiled_net PRIVATE BOOST_ASIO_SEPARATE_COMPILATION BOOST_BEAST_SEPARATE_COMPILATION)
target_link_libraries(precompiled_net PRIVATE Boost::headers)

function(incise_precompiled set)
  foreach(target ${ARGN})
    target_compile_options(${target} PRIVATE ${precompiled_options})
    target_precompile_headers(${target} REUSE_FROM precompiled_${set})
  endforeach()
endfunction()
