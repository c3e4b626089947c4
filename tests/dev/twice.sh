#!/bin/sh
# Runs a test, and once more if it fails: for tests that depend on programs that are not ours and now and then fail
# by themselves (umockdev's preloaded library ends a process that opens a device at the wrong moment; a browser without
# a graphics card may miss events on a very busy machine). The first failure is printed as well.
#
# INCISE_TEST_PRELOAD: libraries to preload into the test, and not into this shell, which does not live with a sanitizer's.
run() { env ${INCISE_TEST_PRELOAD:+LD_PRELOAD="$INCISE_TEST_PRELOAD"} "$@"; }
run "$@" && exit
echo "failed once; once more:"
run "$@"
