#!/usr/bin/env bash
# installed_test.sh BUILD SOURCE: installs the build, builds a project against what is installed, and runs its program
# against the installed server.
set -euo pipefail

build="$1" source="$2"
work="$(mktemp -d)"
server=
cleanup() {
  if [[ -n $server ]]; then
    kill -TERM "$server" 2> /dev/null || true
    wait "$server" || true
  fi
  rm -rf "$work"
}
trap cleanup EXIT
die() {
  echo "installed_test: $*" >&2
  exit 1
}

cmake --install "$build" --prefix "$work/installed" > "$work/install.log" || die "$(tail -n 5 "$work/install.log")"
bin="$work/installed/bin"

# The project of a user, with nothing of this source tree at hand.
cp -r "$source/tests/install/consumer" "$work/"
if ! { cmake -G Ninja -S "$work/consumer" -B "$work/consumer/build" -DCMAKE_PREFIX_PATH="$work/installed" -DCMAKE_BUILD_TYPE=Release \
  "-DCMAKE_CXX_FLAGS=${CONSUMER_FLAGS:-}" && cmake --build "$work/consumer/build"; } > "$work/consumer.log" 2>&1; then
  cat "$work/consumer.log" >&2
  die "the consumer cannot be built"
fi

# The example of client/CLIENTS.md, with the core alone.
embedded="$("$work/consumer/build/embed" 2> "$work/embed.log")" || die "the embedded core failed: $(tail -n 3 "$work/embed.log")"
[[ $embedded == "pieces: 2, 3 after the second cut, 1 after the undo" ]] || die "the embedded core printed '$embedded'"

# Manual pages that man reads without a warning, a completion that completes.
if command -v man > /dev/null; then
  for page in man1/incise.1 man8/incised.8 man8/incise-relay.8; do
    warnings="$(LC_ALL=C.UTF-8 man --warnings -l "$work/installed/share/man/$page" 2>&1 > /dev/null)"
    [[ -z $warnings ]] || die "$page: $warnings"
  done
fi
# shellcheck source=/dev/null
. "$work/installed/share/bash-completion/completions/incise"
COMP_WORDS=(incise repl) COMP_CWORD=1
_incise
[[ ${COMPREPLY[*]} == replay ]] || die "'incise repl' completes to '${COMPREPLY[*]}'"
COMP_WORDS=(incise cut --rep) COMP_CWORD=2
_incise
[[ ${COMPREPLY[*]} == --report ]] || die "'incise cut --rep' completes to '${COMPREPLY[*]}'"

# The service records to its state directory, which is no file system to fill.
grep -Fq '"path": "/var/lib/incise/session.capture"' "$work/installed/etc/incise/incised.json" || die "the service records nothing"
grep -Eq '"keep_free_percent": [1-9]' "$work/installed/etc/incise/incised.json" || die "the service may fill its disk"
grep -qx 'StateDirectory=incise' "$work/installed/lib/systemd/system/incised.service" || die "the service has no directory for captures"
# The package makes the folder for captures; here it is one of this test.
config="$work/installed/etc/incise/incised.json"
sed -i "s|/var/lib/incise/|$work/|" "$config"
"$bin/incised" --check "$config" > "$work/check.log" || die "the configuration is not good"
if command -v systemd-analyze > /dev/null; then
  # Templates are checked as the instance of a session.
  for unit in incised.service incised@liver.service incise-relay@liver.service; do
    sed -E "s|^ExecStart=[^ ]*/([^ /]*)|ExecStart=$bin/\\1|" "$work/installed/lib/systemd/system/${unit/liver/}" > "$work/$unit"
    # It complains about the machine's other units, too.
    if systemd-analyze verify --man=no "$work/$unit" 2>&1 | grep -F "$unit" | grep -v 'not executable'; then
      die "the unit $unit is not good"
    fi
  done
fi

echo '{"mesh": {"phantom": "slab", "target_tets": 3000}, "listen": {"tcp_port": 0, "http_port": 0}, "loop": {"realtime_priority": 0}}' > "$work/session.json"
# Read below, maybe before the shell in the background has made it.
touch "$work/server.out"
"$bin/incised" --config "$work/session.json" >> "$work/server.out" 2> "$work/server.log" &
server=$!
port=
for ((i = 0; i < 600 && ${#port} == 0; i++)); do
  port="$(sed -nE 's/^listening .*tcp=[^ ]*:([0-9]+)( .*)?$/\1/p' "$work/server.out" | head -n 1)"
  kill -0 "$server" 2> /dev/null || die "incised ended: $(tail -n 3 "$work/server.log")"
  sleep 0.1
done
[[ -n $port ]] || die "incised opened no port"
found="$("$work/consumer/build/consumer" "$port")" || die "the consumer failed: $found"
[[ $found =~ ^[0-9]+\ tetrahedra$ ]] || die "the consumer printed '$found'"
expected="$("$bin/incise" phantom slab --size 3000 --out "$work/slab.node" --json | sed -nE 's/.*"tets": ([0-9]+).*/\1/p')"
[[ $found == "$expected tetrahedra" ]] || die "the consumer has $found, the phantom $expected"
