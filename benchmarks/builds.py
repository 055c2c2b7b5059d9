"""On which engine, and with what settings, a measurement runs."""

from __future__ import annotations

import enum
import os
from pathlib import Path

from fbrl.allocator import environment_with_tcmalloc, reason_against_tcmalloc

REPOSITORY = Path(__file__).parent.parent
DEFAULT_ENGINE = REPOSITORY / "build" / "default-engine"
"""gfootball as pip compiles it, where ``scripts/setup.sh --default-engine`` puts it."""

_SETTINGS = ("OMP_WAIT_POLICY", "LD_PRELOAD", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class Build(enum.Enum):
    """An engine and the way in which a program runs on it."""

    FBRL = "fbrl"
    """The engine that fbrl's set-up builds, run as fbrl's commands run it: with tcmalloc where it
    is installed, and with threads of PyTorch that don't spin while they wait."""

    DEFAULT = "default"
    """The engine as pip builds it by default, run as any Python program."""

    @property
    def is_there(self) -> bool:
        """Whether a worker could run on it."""
        return self is Build.FBRL or DEFAULT_ENGINE.is_dir()


def worker_environment(build: Build) -> dict[str, str]:
    """The environment variables of a worker: the user's, without what decides on speed."""
    environment = {name: value for name, value in os.environ.items() if name not in _SETTINGS}
    # A worker on the one build may have another one on the other.
    paths = environment.get("PYTHONPATH", "").split(os.pathsep)
    environment["PYTHONPATH"] = os.pathsep.join(p for p in paths if p != str(DEFAULT_ENGINE))
    if build is Build.FBRL:
        environment = {**environment, "OMP_WAIT_POLICY": "PASSIVE"}
        if reason_against_tcmalloc(environment) is None:
            environment = environment_with_tcmalloc(environment)
        return environment
    path = [str(DEFAULT_ENGINE), environment.get("PYTHONPATH", "")]
    return {**environment, "PYTHONPATH": os.pathsep.join(filter(None, path))}
