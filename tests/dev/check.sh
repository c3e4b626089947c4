# ./dev check (sourced by dev): what a change must pass in addition to ./dev test. Quiet as long as nothing is found.
# shellcheck shell=bash disable=SC2154  # root is dev's

readonly check_max_files=40 # that clang-tidy looks at
readonly check_only_wasm=(server/wasm/exceptions.cpp server/wasm/exports.cpp) # not compiled here: clang-tidy has no flags for them
readonly check_sanitized=(core_tests protocol_test mesh_io_test fuzz_framing fuzz_message fuzz_capture fuzz_session_state
  fuzz_motion fuzz_mesh)

# Runs a step in a shell of its own, its output to a log that is shown where it fails.
check_step() { # NAME COMMAND...
  local name="$1" log="$root/build/check/${1// /_}.log" begin=$SECONDS
  shift
  echo "dev: check: $name"
  if ("$@") > "$log" 2>&1; then
    check_passed+=("$name $((SECONDS - begin)) s")
  else
    tail -n 40 "$log" >&2
    check_failed+=("$name (see $log)")
  fi
}

# The commit that a branch left main at; on main itself the one before.
check_base() {
  local main base
  for main in origin/main main; do
    base="$(git merge-base HEAD "$main" 2> /dev/null)" || continue
    if [[ $base != "$(git rev-parse HEAD)" ]]; then break; fi
    base=
  done
  [[ -n ${base:-} ]] || base="$(git rev-parse -q --verify HEAD^ 2> /dev/null || true)"
  echo "$base"
}

# The C++ files that differ from a commit or are new, those with the most new lines first.
check_changed() { # COMMIT
  { git diff --numstat --no-renames "$1" -- '*.cpp' '*.hpp' &&
    git ls-files --others --exclude-standard -- '*.cpp' '*.hpp' | xargs -r wc -l | awk '$2 != "total" { print $1 "\t0\t" $2 }'; } |
    sort -rn | cut -f 3 | while IFS= read -r file; do
    if [[ -f $file ]]; then printf '%s\n' "$file"; fi
  done
}

check_layout() { # FILES
  (($# == 0)) || clang-format-14 --dry-run -Werror "$@"
}

# Headers too, as files of their own: each includes what it needs.
check_lint() { # FILES
  local file files=()
  for file in "$@"; do
    if ! contains "$file" "${check_only_wasm[@]}"; then files+=("$file"); fi
  done
  ((${#files[@]})) || return 0
  configure lint && cmake --build build/lint --target generated/protocol/incise_generated.h || return 1
  printf '%s\0' "${files[@]:0:check_max_files}" | xargs -0 -P "$(nproc)" -n 1 clang-tidy-14 --quiet -p build/lint
}

# Real meshes take too long here; ./dev test has them.
check_sanitizers() {
  configure asan && cmake --build build/asan --target "${check_sanitized[@]}" || return 1
  env -u INCISE_DATA ctest --test-dir build/asan --output-on-failure --no-tests=error -j "$(nproc)" \
    -R "^($(IFS='|' && echo "${check_sanitized[*]}"))\$"
}

check_golden_hashes() { # PRESET
  configure "$1" && cmake --build "build/$1" --target incise || return 1
  ctest --test-dir "build/$1" --output-on-failure --no-tests=error -j "$(nproc)" -L '^replay$'
}

check_command() { # [COMMIT]
  (($# <= 1)) || misuse "check takes one commit to compare with; found $*"
  cd "$root" || exit
  local base files=() check_passed=() check_failed=()
  base="${1:-$(check_base)}"
  [[ -z $base ]] || git rev-parse -q --verify "$base^{commit}" > /dev/null 2>&1 || misuse "there is no commit '$base'"
  need build clang lint viewer wasm
  mkdir -p build/check
  if [[ -n $base ]]; then
    mapfile -t files < <(check_changed "$base")
  else
    echo "dev: no commit to compare with, so no file counts as changed; ./dev lint looks at all"
  fi
  if ((${#files[@]} > check_max_files)); then
    echo "dev: ${#files[@]} C++ files differ from $base; clang-tidy looks at $check_max_files, ./dev lint at all"
  fi
  check_step "include rules" python3 -B tests/dev/include_rules.py
  check_step "layout" check_layout "${files[@]}"
  check_step "lint" check_lint "${files[@]}"
  check_step "golden hashes, g++" check_golden_hashes release
  check_step "golden hashes, clang" check_golden_hashes clang
  check_step "sanitizers" check_sanitizers
  local list
  if ((${#check_failed[@]})); then
    printf -v list ', %s' "${check_failed[@]}"
    die "check found faults: ${list:2}"
  fi
  printf -v list ', %s' "${check_passed[@]}"
  echo "dev: check passed (${#files[@]} changed C++ files): ${list:2}"
}
