# shellcheck shell=bash
# shellcheck disable=SC2034  # setup.sh reads what is set here
# Which Python to use, and the virtual environment.

# python_version EXECUTABLE: "3.11"
python_version() {
  "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null
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
  elif ! "$1" -c 'import sys; sys.exit(sys.implementation.name != "cpython")'; then
    echo "is a Python $version that is not CPython, for which torch and the engine are compiled"
  elif ! "$1" -c 'import ensurepip, venv' 2>/dev/null; then
    echo "is Python $version without the venv module (apt-get install python$version-venv)"
  fi
}

# has_headers EXECUTABLE: whether something can be compiled for this Python.
has_headers() {
  "$1" -c 'import os, sys, sysconfig
sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))'
}

# real_python EXECUTABLE: the program behind a virtual environment's, a link or a version manager's shim.
real_python() {
  "$1" -c 'import os, sys
print(os.path.realpath(getattr(sys, "_base_executable", None) or sys.executable))'
}

# Sets PYTHON_FOUND to the first Python that fits, or to nothing, and PYTHON_REPORT to what is wrong
# with each that does not.
look_for_python() {
  local candidate problem candidates=(python3 /usr/bin/python3 /usr/bin/python3.1[0-9])
  if [[ -n ${PYTHON:-} ]]; then candidates=("$PYTHON"); fi
  PYTHON_FOUND=
  PYTHON_REPORT=()
  for candidate in "${candidates[@]}"; do
    [[ -n ${PYTHON:-} ]] || command -v "$candidate" >/dev/null || continue
    problem=$(python_problem "$candidate")
    if [[ -z $problem ]]; then
      PYTHON_FOUND=$(real_python "$candidate")
      return
    fi
    PYTHON_REPORT+=("$candidate $problem")
  done
}

# Stops where there is no Python, with every candidate and what is wrong with it.
require_python() {
  if [[ -n $PYTHON_FOUND ]]; then return; fi
  if [[ -n ${PYTHON:-} ]]; then
    die "PYTHON=$PYTHON: ${PYTHON_REPORT[0]#"$PYTHON "}" \
      "make setup PYTHON=/path/to/a/fitting/python3, or leave PYTHON out to have one found"
  fi
  if [[ ${#PYTHON_REPORT[@]} -gt 0 ]]; then printf '  %s\n' "${PYTHON_REPORT[@]}" >&2; fi
  # All that is missing at once: the engine would ask for the rest in the next call.
  die "no Python that fbrl can use: it needs CPython 3.10 or newer, with the venv module" \
    "$(apt_command "${NOT_INSTALLED[@]:-python3-venv}"), or name another one: make setup PYTHON=/path/to/python3"
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
