"""What a measurement ran on."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import datetime
from importlib import metadata
from pathlib import Path

from fbrl.allocator import reason_against_tcmalloc
from fbrl.checks.memory import memory_limit

_PACKAGES = (
    "fbrl",
    "fbrl-engine",
    "torch",
    "torchrl",
    "tensordict",
    "gymnasium",
    "numpy",
    "stable-baselines3",
)

BUSY = 0.5
"""Load per core from which on a machine counts as busy."""


def describe_machine() -> dict[str, str | float]:
    """Processor, cores, memory, load, versions and the commit, by name."""
    import torch

    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
    return {
        "date": datetime.now().strftime("%Y-%m-%d %H:%M"),
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)),
        "memory in GiB": round(memory_limit() / 2**30, 1),
        "GPU": gpu,
        "load before the run": round(os.getloadavg()[0], 2),
        "tcmalloc": reason_against_tcmalloc(os.environ) or "yes",
        "Python": platform.python_version(),
        **{name: metadata.version(name) for name in _PACKAGES},
        "commit": _commit(),
    }


def load_warning() -> str | None:
    """A sentence where other programs are likely to disturb the measurement."""
    load, cores = os.getloadavg()[0], len(os.sched_getaffinity(0))
    if load < BUSY * cores:
        return None
    return (
        f"The machine is busy: its load average is {load:.1f} on {cores} cores. Ratios of this "
        "run are worth little; end other programs and run it again."
    )


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    values: dict[str, str] = {}
    for line in cpuinfo.splitlines():
        name, _, value = line.partition(":")
        values.setdefault(name.strip(), value.strip())
    model = values.get("model name", platform.processor() or platform.machine())
    return f"{model} (family {values.get('cpu family', '?')}, model {values.get('model', '?')})"


def _commit() -> str:
    describe = ["git", "describe", "--always", "--dirty", "--exclude", "*"]
    process = subprocess.run(
        describe, cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    )
    return process.stdout.strip() or "unknown"
