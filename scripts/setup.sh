#!/usr/bin/env bash
# Everything between a fresh clone and a working .venv: system packages, Python, torch, the
# football engine, fbrl. `make setup` calls it; what is done already is skipped.
#
# Variables, all optional, and remembered for later calls in the same clone until `make clean`:
#   PYTHON  the Python to use (default: the first on PATH, if it fits, or else the system's)
#   TORCH   what pip is asked for (default: torch==2.13.0), options included
# NO_APT=1 leaves the system's packages alone. XDG_CACHE_HOME moves the cache of compiled engines.
#
# setup.sh --check only says by its exit status whether this clone is set up; setup.sh --engine-key
# only prints the key under which the compiled engine is cached; setup.sh --engine-wheel compiles it if
# the cache has none, and ends with the wheel's path; setup.sh --portable-wheels makes of it what other
# machines can install, in dist/engine; setup.sh --default-engine only makes build/default-engine,
# gfootball as pip compiles it by default, which a benchmark compares with.
set -euo pipefail
# A ROS or conda shell sets these, and would put its own modules before the environment's.
unset PYTHONPATH PYTHONHOME

ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$ROOT"
VENV=$ROOT/.venv
STAMP=$VENV/.setup-complete
LOG_DIR=$ROOT/build/setup
CHOICES=(PYTHON TORCH)
CLEANUP=()

clean_up() {
  if declare -F stop_progress >/dev/null; then stop_progress; fi
  if [[ ${#CLEANUP[@]} -gt 0 ]]; then rm -rf "${CLEANUP[@]}"; fi
}
trap clean_up EXIT

# stamped NAME: what the last complete set-up wrote down under that name.
stamped() { sed -n "s/^$1=//p" "$STAMP" 2>/dev/null || true; }

# A choice that is not made now stays as it was made before.
recall_choices() {
  local name
  for name in "${CHOICES[@]}"; do
    if [[ -z ${!name:-} ]]; then printf -v "$name" '%s' "$(stamped "$name")"; fi
  done
}

describe_setup() {
  local name
  for name in "${CHOICES[@]}"; do printf '%s=%s\n' "$name" "${!name}"; done
  printf 'root=%s\n' "$ROOT"
  printf 'files=%s\n' "$(cat pyproject.toml scripts/setup.sh scripts/setup/*.sh | sha256sum | cut -c1-16)"
  printf 'engine=%s %s\n' "$(source_hash "$ENGINE_SOURCE")" \
    "$(if has_render_source; then source_hash "$RENDER_SOURCE"; fi)"
}

is_complete() {
  [[ -f $STAMP && $(<"$STAMP") == "$DESCRIPTION" ]] && "$VENV/bin/python" -c '' 2>/dev/null
}

# shellcheck source=scripts/setup/messages.sh
. scripts/setup/messages.sh
# shellcheck source=scripts/setup/packages.sh
. scripts/setup/packages.sh
# shellcheck source=scripts/setup/python.sh
. scripts/setup/python.sh
# shellcheck source=scripts/setup/cache.sh
. scripts/setup/cache.sh
# shellcheck source=scripts/setup/engine.sh
. scripts/setup/engine.sh
# shellcheck source=scripts/setup/portable.sh
. scripts/setup/portable.sh
# shellcheck source=scripts/setup/default_engine.sh
. scripts/setup/default_engine.sh

# find_python_and_packages: sets PYTHON_FOUND, and installs what the engine is compiled and played with.
find_python_and_packages() {
  local packages
  look_for_python
  mapfile -t packages < <(packages_for_matches)
  install_packages "$LOG_DIR" "${packages[@]}"
  if [[ -z $PYTHON_FOUND ]]; then look_for_python; fi
  require_python
}

recall_choices
DESCRIPTION=$(describe_setup)
case ${1:-} in
  "") if is_complete; then exit 0; fi ;;
  --check)
    if is_complete; then exit 0; else exit 1; fi
    ;;
  --engine-key)
    look_for_python
    require_python
    engine_key "$PYTHON_FOUND"
    exit 0
    ;;
  --engine-wheel)
    mkdir -p "$LOG_DIR"
    find_python_and_packages
    ensure_engine "$PYTHON_FOUND" "$LOG_DIR"
    printf '%s\n' "$ENGINE_WHEEL"
    exit 0
    ;;
  --portable-wheels)
    mkdir -p "$LOG_DIR"
    find_python_and_packages
    make_portable_wheels "$PYTHON_FOUND" "$LOG_DIR" "$ROOT/dist/engine"
    exit 0
    ;;
  --default-engine)
    mkdir -p "$LOG_DIR"
    make_default_engine "$VENV/bin/python" "$LOG_DIR" "$ROOT/build/default-engine"
    exit 0
    ;;
  *)
    die "unknown argument $1" "scripts/setup.sh with no argument, --check, --engine-key, --engine-wheel, --portable-wheels or --default-engine"
    ;;
esac

if [[ $(uname -s) != Linux ]]; then
  die "fbrl's set-up supports Linux, and this is $(uname -s)" "a Linux machine, virtual machine or container"
fi
mkdir -p "$LOG_DIR"
exec 8>"$LOG_DIR/lock"
if ! flock --nonblock 8; then
  say "Another set-up of this clone is running; waiting for it"
  flock 8
  if is_complete; then exit 0; fi
fi

if [[ -n $PYTHON ]] && ! command -v "$PYTHON" >/dev/null; then
  die "PYTHON=$PYTHON: no such program" "make setup PYTHON=/usr/bin/python3, or leave PYTHON out"
fi
find_python_and_packages

# Scripts in a virtual environment name its path: one that was moved is made anew.
fresh=
if [[ -f $STAMP && $(stamped root) != "$ROOT" ]]; then fresh=fresh; fi
make_venv "$PYTHON_FOUND" "$VENV" "$LOG_DIR" "$fresh"
# No longer complete; the choices stay, for the call after a failure.
printf '%s\nunfinished\n' "$DESCRIPTION" >"$STAMP"
pip=("$VENV/bin/python" -m pip --disable-pip-version-check)
# Compiling the modules that nobody imports is half the time; the others are compiled at the end.
install=("${pip[@]}" install --no-compile)

# torch comes first and by exact version: asking for just any may fetch gigabytes anew.
read -r -a torch <<<"${TORCH:-torch==2.13.0}"
run_logged "PyTorch (${torch[0]})" "$LOG_DIR/torch.log" "${install[@]}" "${torch[@]}"

ensure_engine "$PYTHON_FOUND" "$LOG_DIR"
ensure_renderer "$PYTHON_FOUND" "$LOG_DIR"
wheels=("$ENGINE_WHEEL" ${RENDER_WHEEL:+"$RENDER_WHEEL"})
engine=$(printf '%s\n' "${wheels[@]}")
if [[ $(cat "$VENV/.engine" 2>/dev/null) != "$engine" ]]; then
  # Its files have the names of ours, and go with it.
  if "${pip[@]}" show --quiet gfootball 2>/dev/null; then
    run_logged "gfootball out of .venv" "$LOG_DIR/engine-install.log" "${pip[@]}" uninstall -y gfootball
  fi
  # The version may be that of what is installed, and the code another.
  run_logged "Engine into .venv" "$LOG_DIR/engine-install.log" \
    "${install[@]}" --no-deps --force-reinstall "${wheels[@]}"
fi

run_logged "fbrl and its dependencies" "$LOG_DIR/fbrl.log" "${install[@]}" -e ".[football,density,analysis,ray,test,lint,docs,release]"

if ! message=$("$VENV/bin/python" -c 'import fbrl_engine' 2>&1); then
  die "the engine does not load: $(tail -n 1 <<<"$message")" \
    "rm -rf '$(dirname "$ENGINE_WHEEL")' && make setup"
fi
printf '%s\n' "$engine" >"$VENV/.engine"

# Shows that all works together, and leaves the bytecode of what it imports, which every command
# would compile anew where PYTHONDONTWRITEBYTECODE is set, as in many containers.
rm -rf "$LOG_DIR/run"
run_logged "A first training, of seconds" "$LOG_DIR/training.log" \
  env --unset=PYTHONDONTWRITEBYTECODE "$VENV/bin/fbrl-train" academy_empty_goal --total-frames 256 \
  --num-envs 2 --num-steps 64 --eval-episodes 2 --run-dir "$LOG_DIR/run"
printf '%s\n' "$DESCRIPTION" >"$STAMP"
say "Set-up complete in $SECONDS s. Check it with .venv/bin/fbrl-doctor, train with make train"
