# shellcheck shell=bash
# shellcheck disable=SC2034  # setup.sh and engine.sh read what is set here
# System packages: which are missing, and installing them where that is possible.

# The names are the same on Debian 12 and 13 and on Ubuntu 22.04 and 24.04.
PYTHON_PACKAGES=(python3-venv)
BUILD_PACKAGES=(
  cmake g++ make python3-dev
  libboost-python-dev libboost-thread-dev libboost-system-dev libboost-filesystem-dev
  libsdl2-dev libsdl2-image-dev libsdl2-ttf-dev libsdl2-gfx-dev
  libgl1-mesa-dev libegl-dev
)
RENDER_PACKAGES=(libegl1 libegl-mesa0 libgl1-mesa-dri)
# Matches run faster with its allocator, which the commands find by themselves.
ALLOCATOR_PACKAGES=(libtcmalloc-minimal4)

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

# Installs what is missing. What cannot be installed is left in NOT_INSTALLED for later steps,
# since a cached engine needs none of the build packages.
install_system_packages() {
  local log_dir=$1 missing
  if [[ ${NO_APT:-} == 1 ]]; then
    say "System packages: skipped (NO_APT=1)"
    return
  fi
  if ! command -v apt-get >/dev/null || ! command -v dpkg-query >/dev/null; then
    warn "no apt on this system: system packages are not checked. Needed, by their Debian names:"
    printf '  %s\n' \
      "${PYTHON_PACKAGES[*]} ${BUILD_PACKAGES[*]} ${RENDER_PACKAGES[*]} ${ALLOCATOR_PACKAGES[*]}" >&2
    return
  fi
  mapfile -t missing < <(
    missing_packages "${PYTHON_PACKAGES[@]}" "${BUILD_PACKAGES[@]}" "${RENDER_PACKAGES[@]}"
    missing_allocator
  )
  if [[ ${#missing[@]} -eq 0 ]]; then
    say "System packages: all installed"
    return
  fi
  if ! find_root; then
    NOT_INSTALLED=("${missing[@]}")
    warn "these system packages are missing, and this user has neither root nor sudo:"
    printf '  %s\n' "${missing[*]}" >&2
    return
  fi
  say "System packages: installing ${missing[*]}"
  local apt=("${AS_ROOT[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300)
  run_logged "Package lists (apt-get update)" "$log_dir/apt-update.log" "${apt[@]}" update
  run_logged "System packages (apt-get install)" "$log_dir/apt-install.log" \
    "${apt[@]}" install -y --no-install-recommends "${missing[@]}"
}

# apt_command NAME...: what an administrator would type.
apt_command() {
  printf 'sudo apt-get install -y --no-install-recommends %s' "$*"
}
