"""Memory: of ``fbrl-train`` with all that it starts, and of a stored frame."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil
import torch
from tensordict import TensorDictBase

_SECONDS_BETWEEN_LOOKS = 0.2


def peak_of_training(scenario: str, arguments: list[str], seed: int) -> dict[str, float]:
    """Runs ``fbrl-train`` and adds up the peaks of its processes' resident memory.

    Returns:
        ``megabytes`` (of a million bytes). Pages that processes share are counted in each.
    """
    program = Path(sys.executable).with_name("fbrl-train")
    with tempfile.TemporaryDirectory(prefix="fbrl-benchmark-") as directory:
        command = [str(program), scenario, *arguments, "--seed", str(seed)]
        process = subprocess.Popen(
            [*command, "--run-dir", f"{directory}/run"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        peaks: dict[int, int] = {}
        while process.poll() is None:
            _look(process.pid, peaks)
            time.sleep(_SECONDS_BETWEEN_LOOKS)
        output, _ = process.communicate()
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} failed:\n{output}")
    return {"megabytes": sum(peaks.values()) * 1024 / 1e6}


def _look(pid: int, peaks: dict[int, int]) -> None:
    """Notes the peak so far, in KiB, of the process and of everything below it."""
    with contextlib.suppress(psutil.NoSuchProcess, FileNotFoundError, ProcessLookupError):
        root = psutil.Process(pid)
        for process in [root, *root.children(recursive=True)]:
            status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
            for line in status.splitlines():
                if line.startswith("VmHWM:"):
                    peaks[process.pid] = int(line.split()[1])


def stored_frame(scenario: str, seed: int) -> dict[str, float]:
    """Bytes that a frame takes in a collected batch.

    Returns:
        ``cells`` and ``planes``, the observation alone as cell indices and dense, their ratio
        ``planes_per_cells``, and ``frame_with_cells`` with rewards, flags and all.
    """
    from fbrl.envs import make_env

    steps, num_envs = 16, 2

    def collected(observation: str) -> TensorDictBase:
        env = make_env(scenario, num_envs=num_envs, observation=observation, seed=seed)
        batch = env.rollout(steps, break_when_any_done=False)
        env.close()
        return batch

    frames = steps * num_envs
    batch = collected("minimap")
    leaves = batch.values(include_nested=True, leaves_only=True)
    whole = sum(leaf.nbytes for leaf in leaves if isinstance(leaf, torch.Tensor))
    cells, planes = batch["minimap_cells"].nbytes, collected("smm")["smm"].nbytes
    return {
        "cells": cells / frames,
        "frame_with_cells": whole / frames,
        "planes": planes / frames,
        "planes_per_cells": planes / cells,
    }
