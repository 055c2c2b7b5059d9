# shellcheck shell=bash
# What set-up tells the user: steps, progress of the long ones, and failures with their remedy.

say() { printf '==> %s\n' "$*"; }
warn() { printf 'warning: %s\n' "$*" >&2; }

# die WHAT [REMEDY]: one line that names the trouble, one that mends it.
die() {
  printf '\nerror: %s\n' "$1" >&2
  if [[ $# -gt 1 ]]; then printf '  mend it with: %s\n' "$2" >&2; fi
  exit 1
}

# run_logged LABEL LOG COMMAND...: run COMMAND with its output in LOG, showing that it moves.
run_logged() {
  local label=$1 log=$2
  shift 2
  local started=$SECONDS status=0
  : >"$log"
  # The command stays in the foreground, so that Ctrl-C reaches it and all its children.
  report_progress "$label" "$log" &
  PROGRESS_PID=$!
  # pip answers Ctrl-C with an ordinary failure, which is not to be explained as one.
  trap 'INTERRUPTED=1' INT
  "$@" >"$log" 2>&1 </dev/null || status=$?
  trap - INT
  stop_progress
  if [[ -t 1 ]]; then printf '\r\033[K'; fi
  if [[ -n $INTERRUPTED ]]; then
    printf '\nInterrupted; make setup goes on with what is not done yet.\n' >&2
    exit 130
  fi
  if [[ $status -ne 0 ]]; then
    show_failure "$log" >&2
    die "$label failed (exit status $status). Full log: $log" "$(remedy_for "$log")"
  fi
  say "$label: done in $((SECONDS - started)) s"
}

# The errors in a log and its end: with pip's and make's farewells the end alone may say nothing.
show_failure() {
  printf '\n--- errors in %s\n' "$1"
  grep -E '[Ee]rror|ERROR|FATAL|fatal:|Could NOT|No space left' "$1" | tail -n 12 | cut -c1-240 || true
  printf -- '--- its last lines\n'
  tail -n 8 "$1" | cut -c1-240
  printf -- '---\n'
}

INTERRUPTED=
PROGRESS_PID=
stop_progress() {
  [[ -n $PROGRESS_PID ]] || return 0
  kill "$PROGRESS_PID" 2>/dev/null || true
  wait "$PROGRESS_PID" 2>/dev/null || true
  PROGRESS_PID=
}

report_progress() {
  local label=$1 log=$2 started=$SECONDS pause=30 activity never
  # Reading what never comes is a sleep that ends with this shell; a sleep process outlives it.
  exec {never}<> <(:)
  if [[ -t 1 ]]; then pause=1; fi
  while true; do
    read -r -t "$pause" -u "$never" || true
    activity=$(last_activity "$log")
    if [[ -t 1 ]]; then
      printf '\r\033[K    %s: %d s  %s' "$label" "$((SECONDS - started))" "$activity"
    else
      printf '    %s: %d s  %s\n' "$label" "$((SECONDS - started))" "$activity"
    fi
  done
}

# The newest line of a log that says something to a person: a compiler's progress or pip's step.
last_activity() {
  tail -c 20000 "$1" 2>/dev/null |
    grep -oE '\[ *[0-9]+(%|/[0-9]+)\] [A-Z][a-z]+( [A-Z]+)? [a-z]+|(Downloading|Collecting|Installing|Building) .*' |
    tail -n 1 | cut -c1-60 || true
}

# The likely remedy for a failed command, from the words in its log; first match wins.
remedy_for() {
  local log=$1 line pattern remedy
  while IFS='|' read -r pattern remedy; do
    if line=$(grep -m 1 -E -- "${pattern//;/|}" "$log"); then
      # What was missing is named by the log's own words where the pattern alone does not say it.
      line=${line#"${line%%[![:space:]]*}"}
      printf '%s (the log says: %s)\n' "$remedy" "${line:0:160}"
      return
    fi
  done <<'TABLE'
No space left on device|free some disk space (df -h . /tmp; CPU-only torch needs about 1 GB, CUDA torch about 6 GB), then run make setup again
No CMAKE_CXX_COMPILER could be found;c\+\+: not found;g\+\+: not found|sudo apt-get install g++
fatal error: Python.h;Could NOT find Python|sudo apt-get install python3-dev
Rendering needs libraries;Could NOT find SDL2;Could NOT find OpenGL;Could NOT find EGL|sudo apt-get install libsdl2-dev libsdl2-image-dev libsdl2-ttf-dev libsdl2-gfx-dev libgl1-mesa-dev libegl-dev
Killed signal terminated program;out of memory;Cannot allocate memory|free some memory (the compiler was stopped by the system; about 2 GB are needed), then run make setup again
name resolution;Failed to establish a new connection;Network is unreachable;NewConnectionError;ConnectTimeout;ReadTimeout;ProxyError;Temporary failure resolving;Could not resolve;Unable to connect to|check the network (and the proxy or index set in pip's and apt's own configuration), then run make setup again
CERTIFICATE_VERIFY_FAILED|sudo apt-get install ca-certificates (or set pip's "cert" to your organisation's certificate)
Could not get lock|wait until the other apt or dpkg has ended, then run make setup again
is expired \(invalid since|set the machine's clock, or apt's sources to a mirror that is up to date, then run make setup again
Unable to locate package;has no installation candidate|enable the distribution's main (Ubuntu: main and universe) package sources, then run make setup again
Unmet dependencies;unmet dependencies;dpkg was interrupted|sudo dpkg --configure -a && sudo apt-get -f install
No matching distribution found|check the network and pip's index; if both work, the index has no such version for this Python, and another torch is chosen with make setup TORCH="torch==X.Y.Z"
too-recent versioned symbols|this system is newer than auditwheel knows: build on an older one, or, for machines with this very system, install the file that scripts/setup.sh --engine-wheel names
Permission denied|make the directory named in the log writable for this user, then run make setup again
TABLE
  printf 'read the log above, then run make setup again\n'
}
