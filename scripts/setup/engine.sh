# shellcheck shell=bash
# shellcheck disable=SC2034  # setup.sh reads what is set here
# The football engine, fbrl-engine: compiled by pip from engine/, with nothing but a C++ compiler.

ENGINE_SOURCE=engine
# What draws the engine's own pictures, a wheel of its own.
RENDER_SOURCE=engine/render

has_render_source() { [[ -f $RENDER_SOURCE/pyproject.toml ]]; }

# source_hash DIRECTORY: of all that a wheel is compiled from.
source_hash() {
  local skipped=(-name build -o -name dist -o -name tests -o -name __pycache__ -o -name '.*')
  # The renderer is in the engine's folder, and no part of its wheel.
  if [[ $1 == "$ENGINE_SOURCE" ]]; then skipped+=(-o -name render); fi
  (cd "$1" && find . -mindepth 1 \( "${skipped[@]}" \) -prune -o -type f -print0 |
    LC_ALL=C sort -z | xargs -0 sha256sum | sha256sum | cut -c1-16)
}

# engine_key PYTHON [NAME]: names everything that a compiled wheel depends on, the engine's or, with the
# name of the renderer, that one's.
engine_key() {
  local python=$1 name=${2:-fbrl-engine} tag hashes
  tag=$("$python" -c 'import sysconfig; print(sysconfig.get_config_var("SOABI"))')
  hashes="$(source_hash "$ENGINE_SOURCE") ${CXX:-}"
  if [[ $name != fbrl-engine ]]; then hashes+=" $(source_hash "$RENDER_SOURCE")"; fi
  printf '%s-%s-%s-%s\n' "$name" "$tag" "$(system_name)" "$(sha256sum <<<"$hashes" | cut -c1-16)"
}

# ensure_engine PYTHON LOG_DIR: sets ENGINE_WHEEL, compiling it if the cache has none.
ensure_engine() {
  local WHEEL
  ensure_wheel "Engine" "$(engine_key "$1")" "$1" \
    build_wheel "Engine" "$ENGINE_SOURCE" "$1" "$2/engine.log"
  ENGINE_WHEEL=$WHEEL
}

# ensure_renderer PYTHON LOG_DIR: sets RENDER_WHEEL likewise, or to nothing where it cannot be made:
# training needs none.
ensure_renderer() {
  local WHEEL
  RENDER_WHEEL=
  has_render_source || return 0
  if ! has_render_headers; then
    warn "3D videos are missing: what draws them is compiled with SDL and EGL. All else works. For them:"
    printf '  %s && make setup\n' "$(apt_command "${RENDER_BUILD_PACKAGES[@]}" "${RENDER_PACKAGES[@]}")" >&2
    return 0
  fi
  local status=0 build
  build=("Renderer" "$(engine_key "$1" fbrl-engine-render)" "$1"
    build_wheel "Renderer" "$RENDER_SOURCE" "$1" "$2/renderer.log")
  # In a shell of its own: matches are no worse without it, and an interruption is one all the same.
  (trap 'rm -rf "${CLEANUP[@]}"' EXIT && ensure_wheel "${build[@]}") || status=$?
  if [[ $status -eq 130 ]]; then exit 130; fi
  if [[ $status -ne 0 ]]; then
    warn "3D videos are missing, since what draws them could not be compiled (see above). All else works."
    return 0
  fi
  ensure_wheel "${build[@]}" >/dev/null
  RENDER_WHEEL=$WHEEL
}

has_render_headers() {
  printf '#include <%s>\n' SDL2/SDL.h SDL2/SDL_ttf.h SDL2/SDL2_rotozoom.h EGL/egl.h \
    GL/glext.h | "${CXX:-c++}" -DEGL_NO_X11 -E -x c++ - >/dev/null 2>&1
}

# require_compiler PYTHON: what has to be there on a machine that compiles.
require_compiler() {
  has_compiler || die "the engine has to be compiled, and there is no C++ compiler (${CXX:-c++})" \
    "$(apt_command "${NOT_INSTALLED[@]:-g++}"), or another compiler: make setup CXX=/path/to/a/compiler"
  has_headers "$1" || die "the engine has to be compiled, and $1 has no Python.h" \
    "$(apt_command "${NOT_INSTALLED[@]:-python3-dev}"), or another Python: make setup PYTHON=/path/to/python3"
}

# build_wheel LABEL SOURCE PYTHON LOG TARGET: compiles a wheel into the directory TARGET.
build_wheel() {
  local label=$1 source=$2 python=$3 log=$4 target=$5 work
  require_compiler "$python"
  work=$(mktemp -d "${TMPDIR:-/tmp}/fbrl-engine.XXXXXX")
  CLEANUP+=("$work")
  run_logged "$label build tools" "${log%.log}-tools.log" "$python" -m venv "$work/venv"
  say "$label: compiling, about a minute on two cores, once per user; log in $log"
  # No flag that the user has set may change a number of a match.
  run_logged "$label" "$log" env \
    -u MAKEFLAGS -u MFLAGS -u MAKEOVERRIDES -u MAKELEVEL -u CMAKE_GENERATOR -u CMAKE_ARGS \
    -u CFLAGS -u CPPFLAGS -u CXXFLAGS -u LDFLAGS \
    SKBUILD_BUILD_DIR="$work/build" \
    "$work/venv/bin/python" -m pip wheel --verbose --no-deps --wheel-dir "$target" "./$source"
  rm -rf "$work"
}
