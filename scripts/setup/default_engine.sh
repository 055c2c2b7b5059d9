# shellcheck shell=bash
# gfootball as pip compiles it by default, for comparisons: it is a Boost.Python extension, and a
# distribution builds Boost.Python for its own Python only.

GFOOTBALL_VERSION=2.10.2
# Without conda and the like, whose Boost and SDL CMake would take for the system's.
SYSTEM_PATH=/usr/local/bin:/usr/bin:/bin

# boost_python_library EXECUTABLE: path of the newest Boost.Python library made for this Python.
boost_python_library() {
  local version directory found
  version=$(python_version "$1") || return 1
  version=${version/./}
  while IFS= read -r directory; do
    found=$(find "$directory" -maxdepth 1 \
      \( -name "libboost_python$version.so*" -o -name "libboost_python3-py$version.so*" \) \
      2>/dev/null | sort -V | tail -n 1)
    if [[ -n $found ]]; then
      printf '%s\n' "$found"
      return 0
    fi
  done < <(
    "$1" -c 'import sysconfig; print("/usr/lib/%s" % sysconfig.get_config_var("MULTIARCH"))
print(sysconfig.get_config_var("LIBDIR"))'
    printf '%s\n' /usr/lib64 /usr/lib /usr/local/lib
  )
  return 1
}

installed_boost_pythons() {
  local names
  names=$(find /usr/lib /usr/lib64 /usr/local/lib -maxdepth 2 -name 'libboost_python*.so.*' \
    -printf '%f\n' 2>/dev/null | sort -u | paste -sd ' ')
  printf '%s' "${names:-none}"
}

# default_engine_key PYTHON: names everything that it depends on.
default_engine_key() {
  local python=$1 tag boost
  tag=$("$python" -c 'import sysconfig; print(sysconfig.get_config_var("SOABI"))')
  boost=$(readlink -f "$(boost_python_library "$python")" | sed 's/.*\.so\.\{0,1\}//')
  printf 'gfootball-%s-%s-%s-boost%s\n' "$GFOOTBALL_VERSION" "$tag" "$(system_name)" "$boost"
}

# make_default_engine PYTHON LOG_DIR TARGET: with TARGET first on PYTHONPATH it takes the place of the
# engine that PYTHON's environment has.
make_default_engine() {
  local python=$1 log_dir=$2 target=$3 key staging missing=() WHEEL
  if command -v dpkg-query >/dev/null; then
    mapfile -t missing < <(missing_packages "${DEFAULT_ENGINE_PACKAGES[@]}")
  fi
  install_packages "$log_dir" "${missing[@]}"
  if ! boost_python_library "$python" >/dev/null; then
    die "gfootball's default build needs Boost.Python for the Python of .venv, $(python_version "$python") (found: $(installed_boost_pythons))" \
      "$(apt_command "${DEFAULT_ENGINE_PACKAGES[@]}"), and where Boost.Python is for another version: make clean && make setup PYTHON=/usr/bin/python3"
  fi
  key=$(default_engine_key "$python")
  if [[ $(cat "$target/.engine" 2>/dev/null) == "$key" ]]; then
    say "Default engine: already in $target"
    return
  fi
  ensure_wheel "Default engine" "$key" "$python" build_default_engine "$python" "$log_dir"
  mkdir -p "$(dirname "$target")"
  staging=$(mktemp -d "$target.XXXXXX")
  CLEANUP+=("$staging")
  "$python" -m zipfile -e "$WHEEL" "$staging"
  printf '%s\n' "$key" >"$staging/.engine"
  chmod 755 "$staging"
  rm -rf "$target"
  mv -T "$staging" "$target"
  say "Default engine: in $target; PYTHONPATH=$target takes it"
}

# build_default_engine PYTHON LOG_DIR TARGET
build_default_engine() {
  local python=$1 log_dir=$2 target=$3 work
  if [[ ${#NOT_INSTALLED[@]} -gt 0 && ${NO_APT:-} != 1 ]]; then
    die "gfootball's default build needs these packages: ${NOT_INSTALLED[*]}" \
      "$(apt_command "${NOT_INSTALLED[@]}")   (or, with libraries from elsewhere: NO_APT=1)"
  fi
  work=$(mktemp -d "${TMPDIR:-/tmp}/fbrl-engine.XXXXXX")
  CLEANUP+=("$work")
  mkdir "$work/tmp"
  run_logged "Default engine's build tools" "$log_dir/default-engine-tools.log" \
    make_build_venv "$python" "$work/venv"
  write_toolchain "$python" "$work/toolchain.cmake"
  say "Default engine: compiling gfootball $GFOOTBALL_VERSION, 3 to 8 minutes on two cores; log in $log_dir/default-engine.log"
  # make's own variables would reach the engine's make; a CMake generator set by the user would
  # keep it from having a Makefile.
  run_logged "Default engine" "$log_dir/default-engine.log" env \
    -u MAKEFLAGS -u MFLAGS -u MAKEOVERRIDES -u MAKELEVEL -u CMAKE_GENERATOR \
    -u CFLAGS -u CPPFLAGS -u CXXFLAGS -u LDFLAGS \
    PATH="$work/venv/bin:$SYSTEM_PATH" TMPDIR="$work/tmp" \
    CMAKE_POLICY_VERSION_MINIMUM=3.5 CMAKE_TOOLCHAIN_FILE="$work/toolchain.cmake" \
    "$work/venv/bin/python" -m pip wheel --verbose --no-cache-dir --no-deps --no-build-isolation \
    --no-binary gfootball --wheel-dir "$target" "gfootball==$GFOOTBALL_VERSION"
  rm -rf "$work"
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
