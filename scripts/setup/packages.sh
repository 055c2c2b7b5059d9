# shellcheck shell=bash
# shellcheck disable=SC2034  # the other parts read what is set here
# System packages: which are missing, and installing them where that is possible.

# The names are the same on Debian 12 and 13 and on Ubuntu 22.04 and 24.04.
# Matches run faster with its allocator, which the commands find by themselves.
ALLOCATOR_PACKAGES=(libtcmalloc-minimal4)
# What videos of the engine's own pictures are compiled with, and drawn with.
RENDER_BUILD_PACKAGES=(libsdl2-dev libsdl2-ttf-dev libsdl2-gfx-dev libgl-dev libegl-dev)
RENDER_PACKAGES=(libegl1 libegl-mesa0 libgl1-mesa-dri)
# Only for gfootball as pip compiles it, which a benchmark compares with.
DEFAULT_ENGINE_PACKAGES=(
  cmake g++ make python3-dev
  libboost-python-dev libboost-thread-dev libboost-system-dev libboost-filesystem-dev
  libsdl2-dev libsdl2-image-dev libsdl2-ttf-dev libsdl2-gfx-dev libgl1-mesa-dev libegl-dev
)

# What is missing and could not be installed.
NOT_INSTALLED=()

# missing_packages NAME...: those that dpkg does not have installed, one a line.
missing_packages() {
  local name installed
  # dpkg-query fails as a whole when it knows nothing of one name; the others are still printed.
  installed=$(dpkg-query -W -f='${db:Status-Status} ${Package}\n' "$@" 2>/dev/null || true)
  for name in "$@"; do
    grep -qxF "installed $name" <<<"$installed" || printf '%s\n' "$name"
  done
}

# Debian 13 and Ubuntu 24.04 have it as libtcmalloc-minimal4t64, which apt-get takes the old name for.
missing_allocator() {
  [[ -z $(missing_packages "${ALLOCATOR_PACKAGES[@]/%/t64}") ]] ||
    missing_packages "${ALLOCATOR_PACKAGES[@]}"
}

# Sets AS_ROOT to the words before a command that needs root; fails where there is no way.
find_root() {
  AS_ROOT=()
  if [[ $EUID -eq 0 ]]; then return 0; fi
  command -v sudo >/dev/null || return 1
  AS_ROOT=(sudo)
  # Without a terminal nobody can type a password.
  if [[ ! -t 0 ]]; then AS_ROOT+=(-n); fi
  "${AS_ROOT[@]}" true 2>/dev/null
}

# install_packages LOG_DIR NAME...: installs these. What cannot be installed is left in NOT_INSTALLED
# for later steps, since a cached engine needs no compiler, and training none of the rest.
install_packages() {
  local log_dir=$1
  shift
  if [[ $# -eq 0 ]]; then return; fi
  if [[ ${NO_APT:-} == 1 ]]; then
    NOT_INSTALLED=("$@")
    say "System packages: skipped (NO_APT=1): $*"
    return
  fi
  if ! command -v apt-get >/dev/null || ! command -v dpkg-query >/dev/null; then
    NOT_INSTALLED=("$@")
    warn "no apt on this system, so what is missing is not installed. By its Debian names:"
    printf '  %s\n' "$*" >&2
    return
  fi
  if ! find_root; then
    NOT_INSTALLED=("$@")
    warn "these system packages are missing, and this user has neither root nor sudo:"
    printf '  %s\n' "$*" >&2
    return
  fi
  say "System packages: installing $*"
  local apt=("${AS_ROOT[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300)
  run_logged "Package lists (apt-get update)" "$log_dir/apt-update.log" "${apt[@]}" update
  run_logged "System packages (apt-get install)" "$log_dir/apt-install.log" \
    "${apt[@]}" install -y --no-install-recommends "$@"
}

# packages_for_matches: what is missing of all that the engine is compiled with and played with, one a
# line. PYTHON_FOUND is the Python, or empty where none fits.
packages_for_matches() {
  if [[ -z $PYTHON_FOUND ]]; then
    packages_of_python venv
    packages_of_python dev
  elif ! has_headers "$PYTHON_FOUND"; then
    packages_of_python dev
  fi
  if ! has_compiler; then echo g++; fi
  command -v dpkg-query >/dev/null || return 0
  missing_allocator
  if has_render_source; then
    missing_packages "${RENDER_BUILD_PACKAGES[@]}" "${RENDER_PACKAGES[@]}"
  fi
}

# packages_of_python SUFFIX: a distribution's package for its own Python, if that is the one in question.
packages_of_python() {
  local program
  program=$(readlink -f "$(command -v "${PYTHON_FOUND:-${PYTHON:-}}")" || true)
  case $program in
    /usr/bin/python3.*) printf '%s-%s\n' "${program#/usr/bin/}" "$1" ;;
    *) if [[ -z $PYTHON_FOUND && -z ${PYTHON:-} ]]; then printf 'python3-%s\n' "$1"; fi ;;
  esac
}

has_compiler() { command -v "${CXX:-c++}" >/dev/null; }

# apt_command NAME...: what an administrator would type.
apt_command() {
  printf 'sudo apt-get install -y --no-install-recommends %s' "$*"
}
