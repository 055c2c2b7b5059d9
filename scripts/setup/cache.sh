# shellcheck shell=bash
# shellcheck disable=SC2034  # the callers read what is set here
# Compiled wheels, kept once per user: another clone does not compile them again.

engine_cache() { printf '%s/fbrl/engine' "${XDG_CACHE_HOME:-$HOME/.cache}"; }

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

# ensure_wheel LABEL KEY PYTHON BUILD...: sets WHEEL to the wheel that is cached under KEY. If there is
# none, BUILD is called with a directory to put it into.
ensure_wheel() {
  local label=$1 key=$2 python=$3 cache lock staging
  shift 3
  cache=$(engine_cache)
  mkdir -p "$cache" || die "the cache directory $cache cannot be made" \
    "make it writable, or name another one: make setup XDG_CACHE_HOME=/path/to/a/cache"
  if WHEEL=$(cached_wheel "$cache/$key" "$python"); then
    say "$label: compiled before, taken from $cache/$key"
    return
  fi
  touch "$cache/$key.lock" || die "the cache directory $cache is not writable" \
    "make it writable, or name another one: make setup XDG_CACHE_HOME=/path/to/a/cache"
  exec {lock}>"$cache/$key.lock"
  if ! flock --nonblock "$lock"; then
    say "$label: another set-up is compiling it; waiting for that one"
    flock "$lock"
  fi
  if ! WHEEL=$(cached_wheel "$cache/$key" "$python"); then
    # The move is what puts it into the cache, so that nobody ever finds half a wheel there.
    staging=$(mktemp -d "$cache/.staging.XXXXXX")
    CLEANUP+=("$staging")
    "$@" "$staging"
    chmod 755 "$staging"
    rm -rf "${cache:?}/$key"
    mv -T "$staging" "$cache/$key"
    WHEEL=$(cached_wheel "$cache/$key" "$python") ||
      die "no whole wheel in $cache/$key after the build" "rm -rf '$cache/$key' && make setup"
    say "$label: kept in $cache/$key"
  fi
  exec {lock}>&-
}

# system_name: tells apart machines that share a home but not their libraries, such as debian12.
system_name() {
  (. /etc/os-release 2>/dev/null && printf '%s%s' "${ID:-linux}" "${VERSION_ID:-}") || printf linux
}
