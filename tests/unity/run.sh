#!/usr/bin/env bash
# Compiles the Unity package with Mono, its Unity part against tests/unity/stub, and runs its tests against the built incised:
# run.sh PROGRAMS FOLDER [--rounds N] [--only TEXT]. Exit status 77 where Mono is missing.
set -euo pipefail
source="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
programs="$1" folder="$2"
shift 2
if ! command -v mcs mono > /dev/null; then
  echo "skipped: the packages mono-mcs and mono-runtime are missing" >&2
  exit 77
fi
package="$source/client/unity"
compile=(mcs -langversion:7 -warn:4 -warnaserror -debug)
mkdir -p "$folder"
"${compile[@]}" -target:library -out:"$folder/Incise.dll" "$package"/Runtime/Core/*.cs
"${compile[@]}" -target:library -out:"$folder/UnityEngine.dll" -r:"$folder/Incise.dll" "$source"/tests/unity/stub/*.cs
"${compile[@]}" -target:library -out:"$folder/Incise.Unity.dll" -r:"$folder/Incise.dll" -r:"$folder/UnityEngine.dll" \
  "$package"/Runtime/Engine/*.cs "$package"/Samples~/*/*.cs
"${compile[@]}" -out:"$folder/tests.exe" -r:"$folder/Incise.dll" -r:"$folder/UnityEngine.dll" -r:"$folder/Incise.Unity.dll" \
  "$source"/tests/unity/*.cs
"${compile[@]}" -out:"$folder/first_client.exe" -r:"$folder/Incise.dll" "$source/client/examples/first_client.cs"
exec mono --debug "$folder/tests.exe" "$source" "$programs" "$@"
