#!/usr/bin/env bash
# The command line of ./dev, in a copy of its own where cmake, dpkg-query and the like are stand-ins: nothing is built
# or installed, and nothing outside the copy is touched.
# shellcheck disable=SC2016  # the stand-ins expand what is in single quotes
set -euo pipefail

source_dir="$(cd "$(dirname "$0")/../.." && pwd)"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
mkdir -p "$work/config" "$work/stand_ins" "$work/tests/dev"
cp "$source_dir/dev" "$source_dir/CMakePresets.json" "$work/"
cp "$source_dir/config/packages.txt" "$work/config/"

# A program of that name which runs BODY.
stand_in() { # NAME BODY
  printf '#!/bin/bash\n%s\n' "$2" > "$work/stand_ins/$1"
  chmod +x "$work/stand_ins/$1"
}
export PATH="$work/stand_ins:$PATH"
export CALLS="$work/calls"

failures=0
# Runs ./dev and compares its exit status and, where given, a part of what it printed.
expect() { # STATUS TEXT [ARGUMENTS OF dev...]
  local wanted="$1" text="$2" status=0 output
  shift 2
  : > "$CALLS"
  output="$("$work/dev" "$@" 2>&1)" || status=$?
  if [[ $status != "$wanted" || $output != *"$text"* ]]; then
    printf 'dev %s: status %s, wanted %s and "%s"; it printed:\n%s\n' "$*" "$status" "$wanted" "$text" "$output"
    failures=$((failures + 1))
  fi
}
# Whether the stand-ins were called with this, after the last expect.
expect_call() { # TEXT
  if ! grep -qF -- "$1" "$CALLS"; then
    printf 'no call "%s" among:\n%s\n' "$1" "$(cat "$CALLS")"
    failures=$((failures + 1))
  fi
}
expect_no_call() { # TEXT
  if grep -qF -- "$1" "$CALLS"; then
    printf 'unwanted call "%s" among:\n%s\n' "$1" "$(cat "$CALLS")"
    failures=$((failures + 1))
  fi
}

all_packages="$(sed 's/[ #].*//; /^\[/d; /^$/d' "$work/config/packages.txt" | sort -u)"
installed() { # PACKAGES, one a line: what dpkg-query reports
  stand_in dpkg-query "printf 'installed %s, \n' $(tr '\n' ' ' <<< "$1")"
}
stand_in cmake 'echo "cmake $*" >> "$CALLS"; if [[ $* == *" -- -n" ]]; then echo "[1/${STEPS:-1}] a.cpp"; fi'
stand_in nproc 'echo 2'
stand_in ctest 'echo "ctest $*" >> "$CALLS"; printf "    Start 1: core\n1/1 Test #1: core ...   Passed    0.01 sec\n\n100%% tests passed, 0 tests failed out of 1\n"; exit "${CTEST_STATUS:-0}"'
stand_in apt-get 'echo "apt-get $*" >> "$CALLS"; exit "${APT_STATUS:-0}"'
stand_in sudo 'exec "$@"'
installed "$all_packages"

# Help, and mistakes.
expect 0 'usage: ./dev COMMAND'
expect 0 'usage: ./dev COMMAND' help
expect 0 'usage: ./dev COMMAND' --help
expect 2 "unknown command 'biuld'" biuld
expect 2 "unknown preset 'relaese'; the presets are release debug" build relaese
expect 2 "unknown preset 'fuzz'; the presets are release debug" test fuzz
expect 2 "unknown preset '../..'" clean ../..
expect 2 "build takes one preset" build debug asan
expect 2 "--minutes takes a whole number from 1; found '0.5'" fuzz --minutes 0.5
expect 2 "unknown argument '--twice' of demo" demo --twice
expect 2 "demo takes one of --once and --still" demo --once --still
expect 2 "demo --static takes a port from 1 to 65535; found '70000'" demo --static 70000
expect 2 'demo --static takes one port' demo --static 8080 8081
expect 2 "lint takes no argument" lint server

# Presets and ctest's arguments go through; a passed test prints nothing of its own, ctest's last line stays.
expect 0 '' build
expect_call 'cmake --preset release'
expect_call "cmake --build $work/build/release"
expect_no_call apt-get
STEPS=300 expect 0 'building 300 files, about ' build
STEPS=300 expect 0 ' min on 2 cores' build
if STEPS=3 "$work/dev" build | grep -q 'building'; then
  echo 'dev build announces what takes no time'
  failures=$((failures + 1))
fi
expect 0 '100% tests passed, 0 tests failed out of 1' test asan -R core
expect_call "cmake --build $work/build/asan"
expect_call "ctest --test-dir $work/build/asan --output-on-failure"
expect_call '-R core'
if "$work/dev" test | grep -q 'Test *#1'; then
  echo 'dev test prints the tests that passed'
  failures=$((failures + 1))
fi
CTEST_STATUS=8 expect 8 '' test
INCISE_DATA='' expect 0 'INCISE_DATA is not set' test

# The check: every step runs, what fails is named, and only C++ files that differ are linted.
cp "$source_dir/tests/dev/check.sh" "$work/tests/dev/"
echo pass > "$work/tests/dev/include_rules.py"
for tool in clang-format-14 clang-tidy-14; do stand_in "$tool" "echo \"$tool \$*\" >> \"\$CALLS\"; exit \"\${TIDY_STATUS:-0}\""; done
expect 0 'check passed (0 changed C++ files): include rules' check
expect_call 'cmake --build build/clang --target incise'
expect_call 'ctest --test-dir build/clang --output-on-failure --no-tests=error -j 2 -L ^replay$'
expect_call '--test-dir build/asan'
expect_no_call clang-tidy
CTEST_STATUS=8 expect 1 'check found faults: golden hashes, g++ (see ' check
expect_call '--test-dir build/asan'
expect 2 "there is no commit 'nowhere'" check nowhere
(
  cd "$work"
  echo 'int same;' > same.cpp
  git init -q . && git add same.cpp
  git -c user.name=t -c user.email=t@example.invalid -c commit.gpgsign=false commit -q -m one
  echo 'int new_one;' > new.cpp
)
expect 0 'check passed (1 changed C++ files)' check HEAD
expect_call 'clang-format-14 --dry-run -Werror new.cpp'
expect_call 'clang-tidy-14 --quiet -p build/lint new.cpp'
TIDY_STATUS=1 expect 1 'check found faults: layout (see ' check HEAD

# Only what is missing is installed, and only for the command at hand.
installed "$(grep -vxE 'ccache|clang|chromium' <<< "$all_packages")"
expect 0 'installing 1 Debian packages: ccache' build
expect_call 'install -y --no-install-recommends --no-remove ccache'
expect_no_call 'apt-get -q -o Dpkg::Use-Pty=0 -o DPkg::Lock::Timeout=300 update'
expect 0 'installing 2 Debian packages: ccache clang' build clang
APT_STATUS=100 expect 1 'the packages could not be installed' build
expect_call ' update'
expect_no_call cmake

# What another package provides counts as installed.
installed "$(grep -vx 'zlib1g-dev' <<< "$all_packages")"
stand_in dpkg-query "$(tail -n +2 "$work/stand_ins/dpkg-query"); echo 'installed zlib-ng-compat, libz-dev, zlib1g-dev (= 1:1.3)'"
expect 0 '' build
expect_no_call apt-get

# Clean removes one preset, or everything.
mkdir -p "$work/build/debug" "$work/build/asan"
expect 0 '' clean debug
[[ ! -e $work/build/debug && -e $work/build/asan ]] || { echo 'clean debug removed the wrong thing'; failures=$((failures + 1)); }
expect 0 '' clean
[[ ! -e $work/build ]] || { echo 'clean left build/'; failures=$((failures + 1)); }

# The demo: a server and a motion that are stand-ins, on two free ports.
bin="$work/build/release/bin"
mkdir -p "$bin"
cat > "$bin/incised" << 'END'
#!/usr/bin/env python3
import json, os, signal, socket, sys, time
config = json.load(open(sys.argv[sys.argv.index("--config") + 1]))
calls = open(os.environ["CALLS"], "a", buffering=1)
open(os.environ["CALLS"] + ".server", "w").write(str(os.getpid()))
def stop(*_):
    time.sleep(float(os.environ.get("CLOSE_S", 0)))
    print("incised stopped", file=calls)
    sys.exit(0)
signal.signal(signal.SIGTERM, stop)
if os.environ.get("REFUSE"):
    sys.exit("config/demo.json: mesh.path: no such file")
sockets = [socket.create_server(("127.0.0.1", port)) for port in config["listen"].values()]
while True:
    time.sleep(1)
END
cat > "$bin/incise" << 'END'
#!/bin/bash
echo "incise $*" >> "$CALLS"
[[ $1 == stream ]] || exit 0
[[ -z ${MOTION_ENDS_SERVER:-} ]] || { kill -TERM "$(cat "$CALLS.server")"; exit 1; }
exec sleep "${MOTION_S:-0}"
END
printf '#!/bin/bash\necho "incise-xpbd $*" >> "$CALLS"; exec sleep 60\n' > "$bin/incise-xpbd"
chmod +x "$bin/incised" "$bin/incise" "$bin/incise-xpbd"
read -r tcp_port http_port < <(python3 -c '
import socket
a, b = socket.create_server(("127.0.0.1", 0)), socket.create_server(("127.0.0.1", 0))
print(a.getsockname()[1], b.getsockname()[1])')
printf '{\n  "listen": { "tcp_port": %s, "http_port": %s }\n}\n' "$tcp_port" "$http_port" > "$work/config/demo.json"
cp "$work/config/demo.json" "$work/config/demo_soft.json"

# Whether the stand-in server ends within twenty seconds.
expect_server_gone() {
  local tick
  for ((tick = 0; tick < 200; tick++)); do
    grep -q 'incised stopped' "$CALLS" && return
    sleep 0.1
  done
  echo "the demo's server is still there: $1"
  failures=$((failures + 1))
}
# Starts a demo whose motion takes a minute, in the background, its process id in $!, and waits until it plays.
begin_demo() { # ARGUMENTS...
  : > "$CALLS"
  MOTION_S=60 "$work/dev" demo "$@" > /dev/null 2>&1 &
  local tick
  for ((tick = 0; tick < 200; tick++)); do
    grep -q '^incise stream' "$CALLS" && { (($# == 0)) || grep -q "^incise-xpbd 127.0.0.1:$tcp_port" "$CALLS"; } && return
    sleep 0.1
  done
  echo 'the demo does not play its motion'
  failures=$((failures + 1))
}

stand_in python3 'echo "python3 $*" >> "$CALLS"'
expect 0 "http://127.0.0.1:$http_port/" demo --static "$http_port"
expect_call '--target incise_static'
expect_call "python3 -m http.server $http_port --bind 127.0.0.1 --directory build/release/static"
rm "$work/stand_ins/python3"
expect 0 "http://127.0.0.1:$http_port/" demo --once
expect_call "incise stream config/demo_motion.csv --to 127.0.0.1:$tcp_port"
expect_server_gone 'after --once'
expect_call "incise convert config/demo_motion.csv --config config/demo.json --out build/demo/captures/demo.capture"
REFUSE=1 expect 1 'mesh.path: no such file' demo
begin_demo
expect 1 'is in use' demo
kill -TERM "$!"
wait "$!" || { echo "the demo ended with $? at a TERM"; failures=$((failures + 1)); }
# Passes after the first one begin with an uncut body.
: > "$CALLS"
"$work/dev" demo > /dev/null 2>&1 &
for ((tick = 0; tick < 200; tick++)); do
  (($(grep -c '^incise stream' "$CALLS") < 2)) || break
  sleep 0.1
done
passes="$(grep '^incise stream' "$CALLS" | head -n 2 | sed 's/.* --to [^ ]* *//' | paste -sd,)"
[[ $passes == ',--reset' ]] || { echo "the demo's first two passes have the options '$passes'"; failures=$((failures + 1)); }
kill -TERM "$!"
wait "$!" || true
# A server that ends is named as the cause: in a pass, in the pause after one, and where it lets go of the motion before it ends.
expect_named_end() { # STATUS OF incised, WHEN
  wait "$!" && { echo "the demo ended with 0 though its server ended $2"; failures=$((failures + 1)); }
  if [[ $(tail -n 1 "$work/demo.out") != "dev: incised ended with status $1; see build/demo/incised.log" ]] ||
    grep -qE 'Killed|no such job' "$work/demo.out"; then
    echo "the demo whose server ended $2 printed:"
    cat "$work/demo.out"
    failures=$((failures + 1))
  fi
}
for motion_s in 60 0; do
  : > "$CALLS"
  MOTION_S="$motion_s" "$work/dev" demo > "$work/demo.out" 2>&1 &
  for ((tick = 0; tick < 200; tick++)); do
    if grep -q '^incise stream' "$CALLS"; then break; fi
    sleep 0.1
  done
  sleep 1
  kill -KILL "$(cat "$CALLS.server")"
  expect_named_end 137 "beside a motion of $motion_s s"
done
MOTION_ENDS_SERVER=1 CLOSE_S=1 "$work/dev" demo > "$work/demo.out" 2>&1 &
expect_named_end 0 'after the motion'
# Without a motion it only waits. Not the last demo's output: it would be taken for this one's.
: > "$CALLS"
: > "$work/demo.out"
"$work/dev" demo --still > "$work/demo.out" 2>&1 &
for ((tick = 0; tick < 200; tick++)); do
  if grep -q "http://127.0.0.1:$http_port/" "$work/demo.out"; then break; fi
  sleep 0.1
done
((tick < 200)) || { echo "the demo prints no address:"; cat "$work/demo.out"; failures=$((failures + 1)); }
expect_no_call 'incise stream'
kill -TERM "$!"
wait "$!" || { echo "the demo without a motion ended with $? at a TERM"; failures=$((failures + 1)); }
begin_demo
kill -KILL "$!"
wait "$!" 2> /dev/null || true
expect_server_gone 'after kill -9 of dev'

# The soft demo runs a simulation, too.
begin_demo --soft
kill -TERM "$!"
wait "$!" || { echo "the soft demo ended with $? at a TERM"; failures=$((failures + 1)); }
expect_server_gone 'after --soft'

((failures == 0)) || exit 1
echo "the command line of ./dev holds"
