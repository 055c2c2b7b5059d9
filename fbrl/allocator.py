"""tcmalloc in the place of the C library's allocator.

The engine makes and frees many small objects in every step, which tcmalloc does in less time. An
allocator must be named in ``LD_PRELOAD`` before a process starts, so the commands that play
matches start themselves anew, once, where tcmalloc is installed.
"""

from __future__ import annotations

import os
import re
import sys
import sysconfig
from collections.abc import Mapping
from pathlib import Path

TCMALLOC = "libtcmalloc_minimal.so.4"
"""Of Debian's and Ubuntu's package ``libtcmalloc-minimal4``."""

SWITCH = "FBRL_TCMALLOC"
"""Environment variable: 0 keeps the allocator that there is."""

# It must not be looked for by loading it: two allocators in one process crash it.
_DIRECTORIES = (
    f"/usr/lib/{sysconfig.get_config_var('MULTIARCH')}",
    str(sysconfig.get_config_var("LIBDIR")),
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
)


def preload_tcmalloc(program: str) -> None:
    """Starts this process anew with tcmalloc; returns where that was done or is not possible.

    The process keeps its id, its arguments and everything else that a parent sees. Nothing happens
    in a process that is no such command, as a test or a notebook that calls the command's function.
    """
    is_program = sys.orig_argv[-len(sys.argv) :] == sys.argv and Path(sys.argv[0]).name == program
    if is_program and reason_against_tcmalloc(os.environ) is None:
        sys.stdout.flush()
        sys.stderr.flush()
        command = [sys.executable, *sys.orig_argv[1:]]
        os.execve(sys.executable, command, environment_with_tcmalloc(os.environ))


def reason_against_tcmalloc(environment: Mapping[str, str]) -> str | None:
    """Why a command started in this environment would not preload tcmalloc; None if it would."""
    if environment.get(SWITCH) == "0":
        return f"{SWITCH}=0"
    preloaded = environment.get("LD_PRELOAD", "")
    if re.search(r"malloc|hoard", preloaded):
        return f"LD_PRELOAD={preloaded}"
    if find_tcmalloc() is None:
        return f"{TCMALLOC} isn't installed"
    return None


def environment_with_tcmalloc(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment in which a process uses tcmalloc and doesn't start itself anew."""
    preloaded = [library for library in (environment.get("LD_PRELOAD"), find_tcmalloc()) if library]
    return {**environment, "LD_PRELOAD": ":".join(preloaded), SWITCH: "0"}


def find_tcmalloc() -> str | None:
    """Path of the library, if it is installed."""
    paths = (Path(directory, TCMALLOC) for directory in _DIRECTORIES)
    return next((str(path) for path in paths if path.exists()), None)
