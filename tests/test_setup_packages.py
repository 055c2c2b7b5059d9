"""System packages whose names differ between distributions."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
# A machine on which dpkg knows everything, but of tcmalloc's two names only those in $KNOWN.
SCRIPT = """
set -euo pipefail; for part in scripts/setup/*.sh; do . $part; done
dpkg-query() {
  shift 2
  for name in "$@"; do
    case $name in
      libtcmalloc*) [[ " $KNOWN " == *" $name "* ]] && echo "installed $name" || FAILED=1 ;;
      *) echo "installed $name" ;;
    esac
  done
  return "${FAILED:-0}"
}
apt-get() { :; }
find_root() { AS_ROOT=(); }
has_compiler() { :; }
run_logged() { echo "ran: ${*:3}"; }
look_for_python
has_headers() { :; }
mapfile -t packages < <(packages_for_matches)
install_packages . "${packages[@]}"
"""


@pytest.mark.parametrize("known", ["libtcmalloc-minimal4", "libtcmalloc-minimal4t64"])
def test_either_name_of_the_allocators_package_is_enough(known: str) -> None:
    assert "ran:" not in install(known)


def test_without_either_the_name_that_all_distributions_take_is_installed() -> None:
    output = install("")
    assert output.rstrip().endswith("install -y --no-install-recommends libtcmalloc-minimal4")


def install(known: str) -> str:
    process = subprocess.run(
        ["bash", "-c", SCRIPT],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        env={"PATH": "/usr/local/bin:/usr/bin:/bin", "KNOWN": known},
        timeout=60,
    )
    assert process.returncode == 0, process.stderr
    return process.stdout
