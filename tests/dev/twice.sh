#!/bin/sh
# Runs a test, and once more where it fails: for tests that stand on programs that are not ours and that now and then fall
# over by themselves (umockdev's preloaded library ends a process that opens a device in the wrong moment; a browser without
# a graphics card may miss events on a machine that is very busy). What failed first is printed all the same.
#
# INCISE_TEST_PRELOAD: libraries to preload into the test, and not into this shell, which does not live with a sanitizer's.
run() { env ${INCISE_TEST_PRELOAD:+LD_PRELOAD="$INCISE_TEST_PRELOAD"} "$@"; }
run "$@" && exit
echo "failed once; once more:"
run "$@"
