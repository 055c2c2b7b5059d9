# shellcheck shell=bash
# shellcheck disable=SC2034  # setup.sh reads what is set here
# Which Python to use, and the virtual environment. The engine is a Boost.Python extension, and a
# distribution builds Boost.Python only for its own Python: that is the one looked at first, and
# one from pyenv or conda, even first on PATH, is taken only where Boost.Python fits it.

# python_version EXECUTABLE: "3.11"
python_version() {
  "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null
}

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

# python_problem EXECUTABLE: why it cannot be used; nothing where it can.
python_problem() {
  local version
  if ! command -v "$1" >/dev/null; then
    echo "no such program"
  elif ! version=$(python_version "$1"); then
    echo "does not run"
  elif ! "$1" -c 'import sys; sys.exit(sys.version_info < (3, 10))'; then
    echo "is Python $version; fbrl needs 3.10 or newer"
  elif ! "$1" -c 'import ensurepip, venv' 2>/dev/null; then
    echo "is Python $version without the venv module (apt-get install python$version-venv)"
  elif ! boost_python_library "$1" >/dev/null; then
    echo "is Python $version, and no Boost.Python for $version is installed" \
      "(found: $(installed_boost_pythons))"
  fi
}

installed_boost_pythons() {
  local names
  names=$(find /usr/lib /usr/lib64 /usr/local/lib -maxdepth 2 -name 'libboost_python*.so.*' \
    -printf '%f\n' 2>/dev/null | sort -u | paste -sd ' ')
  printf '%s' "${names:-none}"
}

# Sets PYTHON_FOUND, or stops with every candidate and what is wrong with it.
find_python() {
  local candidate problem candidates=() report=()
  local package packages=(python3-venv python3-dev libboost-python-dev)
  if [[ -n ${PYTHON:-} ]]; then
    problem=$(python_problem "$PYTHON")
    [[ -z $problem ]] || die "PYTHON=$PYTHON: $problem" \
      "make setup PYTHON=/path/to/a/fitting/python3, or leave PYTHON out to have one found"
    PYTHON_FOUND=$(command -v "$PYTHON")
    return
  fi
  candidates=(/usr/bin/python3 /usr/bin/python3.1[0-9])
  if command -v python3 >/dev/null; then candidates+=("$(command -v python3)"); fi
  for candidate in "${candidates[@]}"; do
    [[ -x $candidate ]] || continue
    problem=$(python_problem "$candidate")
    if [[ -z $problem ]]; then
      PYTHON_FOUND=$candidate
      return
    fi
    report+=("$candidate $problem")
  done
  if [[ ${#report[@]} -gt 0 ]]; then printf '  %s\n' "${report[@]}" >&2; fi
  # All that is missing at once: the engine would ask for the rest in the next call.
  for package in "${NOT_INSTALLED[@]}"; do
    [[ " ${packages[*]} " == *" $package "* ]] || packages+=("$package")
  done
  die "no Python that fbrl can use: it needs 3.10 or newer, with venv, and the Boost.Python for it" \
    "$(apt_command "${packages[@]}")"
}

# make_venv PYTHON VENV LOG_DIR [fresh]: a working virtual environment of that Python's version.
make_venv() {
  local python=$1 venv=$2 log_dir=$3 fresh=${4:-}
  if [[ -z $fresh && $(python_version "$venv/bin/python") == "$(python_version "$python")" ]] &&
    "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    return
  fi
  say "Virtual environment: $venv with $python ($(python_version "$python"))"
  run_logged "Virtual environment" "$log_dir/venv.log" "$python" -m venv --clear "$venv"
}
