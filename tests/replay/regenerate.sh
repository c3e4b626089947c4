#!/usr/bin/env bash
# Writes the golden captures again with the incise of a build, poses and configurations as they are, hashes as this build
# computes them: ./regenerate.sh ../../build/release/bin. Says for each whether its hashes changed.
set -euo pipefail
bin="$(cd "${1:?usage: regenerate.sh BIN_DIR}" && pwd)"
cd "$(dirname "$0")"
for capture in *.capture; do
  if "$bin/incise" replay "$capture" --verify > /dev/null 2>&1; then
    echo "$capture: as it was"
    continue
  fi
  "$bin/incise" convert "$capture" --mesh body --out "$capture.new" > /dev/null
  mv "$capture.new" "$capture"
  echo "$capture: written"
done
