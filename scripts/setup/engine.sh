# shellcheck shell=bash
# shellcheck disable=SC2034  # setup.sh reads what is set here
# The football engine: a wheel compiled once per user and kept in the cache.

GFOOTBALL_VERSION=2.10.2
# 1.3 to 1.45 times the speed of the default build, with bit-identical matches.
ENGINE_CXXFLAGS=${ENGINE_CXXFLAGS:--DNDEBUG -flto=2 -ftls-model=initial-exec -fno-semantic-interposition -fvisibility-inlines-hidden}
ENGINE_LDFLAGS=${ENGINE_LDFLAGS:--Wl,-Bsymbolic}
# Without conda and the like, whose Boost and SDL CMake would take for the system's.
ENGINE_PATH=/usr/local/bin:/usr/bin:/bin

engine_cache() { printf '%s/fbrl/engine' "${XDG_CACHE_HOME:-$HOME/.cache}"; }

# engine_key PYTHON: names everything that a compiled engine depends on.
engine_key() {
  local python=$1 tag system boost flags
  tag=$("$python" -c 'import sys, sysconfig
print("cp%d%d-%s" % (*sys.version_info[:2], sysconfig.get_platform().replace("-", "_")))')
  system=$(. /etc/os-release 2>/dev/null && printf '%s%s' "${ID:-linux}" "${VERSION_ID:-}") || system=linux
  boost=$(boost_python_library "$python") || boost=none
  boost=$(readlink -f "$boost" | sed 's/.*\.so\.\{0,1\}//')
  # The library path tells two Pythons of one version apart: the engine is linked to one of them.
  flags=$(printf '%s\n' "$ENGINE_CXXFLAGS" "$ENGINE_LDFLAGS" \
    "$("$python" -c 'import sysconfig; print(sysconfig.get_config_var("LIBDIR"))')" |
    sha256sum | cut -c1-8)
  printf 'gfootball-%s-%s-%s-boost%s-%s\n' "$GFOOTBALL_VERSION" "$tag" "$system" "$boost" "$flags"
}

# cached_wheel DIRECTORY PYTHON: the wheel in it, if it is whole.
cached_wheel() {
  local wheel
  for wheel in "$1"/*.whl; do
    if [[ -f $wheel ]] && "$2" -m zipfile -t "$wheel" >/dev/null 2>&1; then
      printf '%s\n' "$wheel"
      return 0
    fi
  done
  return 1
}

# Sets ENGINE_WHEEL to the compiled wheel, building it if the cache has none.
ensure_engine_wheel() {
  local python=$1 log_dir=$2 key cache
  key=$(engine_key "$python")
  cache=$(engine_cache)
  mkdir -p "$cache" || die "the cache directory $cache cannot be made" \
    "make it writable, or name another one: make setup XDG_CACHE_HOME=/path/to/a/cache"
  if ENGINE_WHEEL=$(cached_wheel "$cache/$key" "$python"); then
    say "Engine: compiled before, taken from $cache/$key"
    return
  fi
  touch "$cache/$key.lock" || die "the cache directory $cache is not writable" \
    "make it writable, or name another one: make setup XDG_CACHE_HOME=/path/to/a/cache"
  exec 9>"$cache/$key.lock"
  if ! flock --nonblock 9; then
    say "Engine: another set-up is compiling it; waiting for that one"
    flock 9
  fi
  if ! ENGINE_WHEEL=$(cached_wheel "$cache/$key" "$python"); then
    require_build_packages
    build_engine "$python" "$log_dir" "$cache/$key"
    ENGINE_WHEEL=$(cached_wheel "$cache/$key" "$python") ||
      die "no whole wheel in $cache/$key after the build" "rm -rf '$cache/$key' && make setup"
  fi
  exec 9>&-
}

# make_default_engine PYTHON LOG_DIR TARGET: gfootball with the engine as pip compiles it when it is
# told nothing, for comparisons. With TARGET first on PYTHONPATH it takes the installed one's place.
make_default_engine() {
  local python=$1 log_dir=$2 target=$3 key staging
  local ENGINE_CXXFLAGS="" ENGINE_LDFLAGS=""
  key=$(engine_key "$python")
  if [[ $(cat "$target/.engine" 2>/dev/null) == "$key" ]]; then
    say "Default engine: already in $target"
    return
  fi
  ensure_engine_wheel "$python" "$log_dir"
  mkdir -p "$(dirname "$target")"
  staging=$(mktemp -d "$target.XXXXXX")
  CLEANUP+=("$staging")
  "$python" -m zipfile -e "$ENGINE_WHEEL" "$staging"
  printf '%s\n' "$key" >"$staging/.engine"
  chmod 755 "$staging"
  rm -rf "$target"
  mv -T "$staging" "$target"
  say "Default engine: in $target; PYTHONPATH=$target takes it"
}

require_build_packages() {
  local package program missing=()
  for package in "${NOT_INSTALLED[@]}"; do
    [[ " ${BUILD_PACKAGES[*]} " != *" $package "* ]] || missing+=("$package")
  done
  if [[ ${#missing[@]} -gt 0 ]]; then
    die "the engine has to be compiled, and these packages for it are missing: ${missing[*]}" \
      "$(apt_command "${NOT_INSTALLED[@]}")   (or, with libraries from elsewhere: make setup NO_APT=1)"
  fi
  for program in cmake make c++; do
    PATH=$ENGINE_PATH command -v "$program" >/dev/null ||
      die "the engine has to be compiled, and there is no $program in $ENGINE_PATH" "$(apt_command "${BUILD_PACKAGES[@]}")"
  done
}

build_engine() {
  local python=$1 log_dir=$2 target=$3 work staging
  work=$(mktemp -d "${TMPDIR:-/tmp}/fbrl-engine.XXXXXX")
  CLEANUP+=("$work")
  mkdir "$work/tmp" "$work/wheels"
  run_logged "Engine build tools" "$log_dir/engine-tools.log" make_build_venv "$python" "$work/venv"
  write_toolchain "$python" "$work/toolchain.cmake"

  say "Engine: compiling gfootball $GFOOTBALL_VERSION, 3 to 8 minutes on two cores, once per machine"
  say "Engine: log in $log_dir/engine.log"
  # make's own variables would reach the engine's make; a CMake generator set by the user would
  # keep it from having a Makefile.
  run_logged "Engine" "$log_dir/engine.log" env \
    -u MAKEFLAGS -u MFLAGS -u MAKEOVERRIDES -u MAKELEVEL -u CMAKE_GENERATOR -u CFLAGS -u CPPFLAGS \
    PATH="$work/venv/bin:$ENGINE_PATH" \
    TMPDIR="$work/tmp" \
    CXXFLAGS="$ENGINE_CXXFLAGS" LDFLAGS="$ENGINE_LDFLAGS" \
    CMAKE_POLICY_VERSION_MINIMUM=3.5 CMAKE_TOOLCHAIN_FILE="$work/toolchain.cmake" \
    "$work/venv/bin/python" -m pip wheel --verbose --no-cache-dir --no-deps --no-build-isolation \
    --no-binary gfootball --wheel-dir "$work/wheels" "gfootball==$GFOOTBALL_VERSION"

  # The move is what puts it into the cache, so that nobody ever finds half a wheel there.
  staging=$(mktemp -d "$(dirname "$target")/.staging.XXXXXX")
  CLEANUP+=("$staging")
  cp "$work"/wheels/gfootball-*.whl "$staging/"
  chmod 755 "$staging"
  rm -rf "$target"
  mv -T "$staging" "$target"
  say "Engine: kept in $target"
}

# Its own environment: the build needs an old setuptools, and calls the first python3 on PATH.
make_build_venv() {
  "$1" -m venv "$2" && "$2/bin/python" -m pip install "setuptools<81" wheel psutil
}

# Left alone, CMake may take another of the machine's Pythons than the one we build for.
write_toolchain() {
  "$1" - >"$2" <<'PYTHON'
import os
import sysconfig

variables = sysconfig.get_config_vars()
library = os.path.join(variables["LIBDIR"], variables["LDLIBRARY"])
if os.path.exists(library):
    print('set(Python_INCLUDE_DIR "%s")' % variables["INCLUDEPY"])
    print('set(Python_LIBRARY "%s")' % library)
PYTHON
}
