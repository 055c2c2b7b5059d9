"""The checks of an installation, each with remedies for what it finds wrong.

Importing this module imports none of what is checked.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Status = Literal["ok", "warn", "fail"]

_REBUILD = "rebuild the environment: `make clean && make setup`"

_ENGINE_REMEDY = "run `make setup` in fbrl's repository, or install what `make engine-wheel` made"


class CheckError(Exception):
    """Raised by a check that finds something wrong.

    Args:
        detail: What is wrong.
        remedy: What mends it.
        status: ``"fail"``, or ``"warn"`` for what works less well.
    """

    def __init__(self, detail: str, remedy: str, status: Status = "fail") -> None:
        super().__init__(detail)
        self.detail = detail
        self.remedy = remedy
        self.status = status


@dataclass(frozen=True)
class Check:
    """A part of the installation that can be checked.

    Attributes:
        name: Shown in the table.
        function: Returns a line of detail, or raises; :class:`CheckError` where it knows the
            remedy.
        remedy: For the failures that the function doesn't foresee, crashes and hangs included.
        time_limit: Seconds after which the check is stopped and has failed.
        needed: Whether training depends on it; if not, a failure counts as a warning.
    """

    name: str
    function: Callable[[], str]
    remedy: str
    time_limit: float = 60.0
    needed: bool = True


def check_packages() -> str:
    """Whether the packages that fbrl declares are installed, in versions that it works with."""
    from packaging.requirements import Requirement

    problems = []
    for line in importlib.metadata.requires("fbrl") or ():
        requirement = Requirement(line)
        if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            problems.append(f"{requirement.name} is missing")
            continue
        if not requirement.specifier.contains(version, prereleases=True):
            problems.append(f"{requirement.name} {version} is not {requirement.specifier}")
    if problems:
        raise CheckError(", ".join(problems), "run `make setup`, or `pip install -U fbrl`")
    return f"Python {platform.python_version()} at {sys.executable}, all packages fit"


def check_engine() -> str:
    """Whether the engine can be imported, and no gfootball has been installed over it."""
    if version := _installed_version("gfootball"):
        raise CheckError(
            f"gfootball {version} is installed too, and its files have the names of fbrl-engine's",
            "`pip uninstall -y gfootball`, then install fbrl-engine anew: "
            "`rm .venv/.engine .venv/.setup-complete; make setup`, or "
            "`pip install --force-reinstall --no-deps` its wheel",
        )
    from fbrl.envs.engine import load_gfootball

    try:
        load_gfootball()
    except ImportError as error:
        cause = " ".join(str(error.__cause__ or error).split())
        if "GLIBC" in cause:
            raise CheckError(
                cause,
                "this engine was compiled on a newer system: compile it on this one, or on the "
                "oldest that it shall run on, with `make setup` or `make engine-wheel`",
            ) from error
        if "cannot import name '_native'" in cause:
            raise CheckError(
                f"the installed engine isn't for {platform.python_implementation()} "
                f"{platform.python_version()} on {platform.machine()}",
                _ENGINE_REMEDY,
            ) from error
        raise
    return f"fbrl-engine {_installed_version('fbrl-engine') or 'from a folder'}"


def _installed_version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def check_match() -> str:
    """Plays a few steps of a real match."""
    from fbrl.envs import FootballEnv

    env = FootballEnv("academy_empty_goal_close")
    before, _ = env.reset(seed=0)
    right = 5
    started = time.perf_counter()
    steps = 10
    for _ in range(steps):
        after, *_ = env.step(right)
    milliseconds = (time.perf_counter() - started) / steps * 1000
    if (before["ball"] == after["ball"]).all():
        raise CheckError(f"the ball hasn't moved within {steps} steps of a match", _REBUILD)
    return f"{steps} steps of academy_empty_goal_close, {milliseconds:.1f} ms each"


def check_allocator() -> str:
    """Whether the commands that play matches use tcmalloc."""
    from fbrl.allocator import (
        TCMALLOC,
        environment_with_tcmalloc,
        find_tcmalloc,
        reason_against_tcmalloc,
    )

    if find_tcmalloc() is None:
        raise CheckError(
            f"{TCMALLOC} isn't installed, and matches are slower without it",
            _TCMALLOC_REMEDY,
            "warn",
        )
    if reason := reason_against_tcmalloc(os.environ):
        return f"left as it is, because of {reason}"
    process = subprocess.run(
        [sys.executable, "-c", "print(open('/proc/self/maps').read())"],
        env=environment_with_tcmalloc(os.environ),
        capture_output=True,
        text=True,
        check=False,
    )
    if TCMALLOC.partition(".")[0] not in process.stdout:
        problem = " ".join(process.stderr.split())
        raise CheckError(f"{TCMALLOC} can't be preloaded: {problem}", _TCMALLOC_REMEDY, "warn")
    return f"{TCMALLOC} is preloaded by the commands that play matches"


def check_torch() -> str:
    """Torch computes on the device that training would choose."""
    import torch

    device = "cuda" if torch.cuda.is_available() else "cpu"
    product = torch.ones(8, 8, device=device) @ torch.ones(8, 8, device=device)
    if product.sum().item() != 512.0:
        raise CheckError(
            f"torch {torch.__version__} computes wrong numbers on {device}",
            "reinstall torch, or train with `--device cpu`",
        )
    if device == "cuda":
        return f"torch {torch.__version__}, CUDA: {torch.cuda.get_device_name()}"
    detail = f"torch {torch.__version__}, CPU with {torch.get_num_threads()} threads"
    if Path("/dev/nvidia0").exists():
        build = f"CUDA {torch.version.cuda}" if torch.version.cuda else "CPU only"
        raise CheckError(
            f"{detail}; there is an NVIDIA GPU that this torch (built for {build}) can't use",
            "install a torch that fits the driver (see pytorch.org): "
            "`make setup TORCH=torch==X.Y.Z`",
            status="warn",
        )
    return detail


def check_tensorboard() -> str:
    """Writes an event file and reads it back."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from torch.utils.tensorboard import SummaryWriter

    with tempfile.TemporaryDirectory(prefix="fbrl-doctor-") as directory:
        with SummaryWriter(directory) as writer:
            writer.add_scalar("doctor/check", 0.5, global_step=3)
        events = EventAccumulator(directory).Reload().Scalars("doctor/check")
    if [(event.step, event.value) for event in events] != [(3, 0.5)]:
        raise CheckError(
            f"an event file was written and reads back as {events}", "`pip install -U tensorboard`"
        )
    return f"tensorboard {importlib.metadata.version('tensorboard')}, event file written and read"


def check_densities() -> str:
    """Loads the densities that come with fbrl and evaluates them over the pitch."""
    import torch

    from fbrl.density import AssistDensity

    density = AssistDensity.default()
    pitch = torch.cartesian_prod(torch.linspace(-1, 1, 201), torch.linspace(-0.42, 0.42, 85))
    details = []
    for name, surface in (("start", density.start), ("end", density.end)):
        highest = float(surface(pitch).max())
        if not 0.9 * surface.peak <= highest <= 1.001 * surface.peak:
            raise CheckError(
                f"the {name} density's highest value is {highest:g}, not its peak {surface.peak:g}",
                "reinstall fbrl: its density file is damaged",
            )
        details.append(f"{name} peak {surface.peak:g}")
    return ", ".join(details)


def check_rendering() -> str:
    """Renders one frame with no display, as videos are made."""
    if importlib.util.find_spec("fbrl_engine_render") is None:
        raise CheckError(
            "fbrl-engine-render isn't installed: `fbrl-watch` makes no 3D videos",
            f"{_ENGINE_REMEDY}, on a machine with SDL's and EGL's headers; see docs/watch.md",
            "warn",
        )
    from fbrl.envs.engine import FIRST_EPISODE
    from fbrl.envs.engine_pictures import EnginePictures

    with EnginePictures(320, 180) as pictures:
        ((_, frame),) = pictures.play(("academy_empty_goal_close", 0, FIRST_EPISODE))
    if frame.std() < 1.0:
        raise CheckError(f"the frame {frame.shape} is of one colour", _RENDER_REMEDY)
    return f"a frame of {frame.shape[1]}x{frame.shape[0]} pixels rendered off-screen"


_RENDER_REMEDY = "`sudo apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri` (only videos need it)"

_TCMALLOC_REMEDY = "`sudo apt-get install libtcmalloc-minimal4`"

RENDERING = "headless rendering"

CHECKS: tuple[Check, ...] = (
    Check("Python packages", check_packages, "run `make setup`"),
    Check("engine import", check_engine, _ENGINE_REMEDY),
    Check("match step", check_match, f"mend the engine import first; else {_REBUILD}"),
    Check("allocator", check_allocator, _TCMALLOC_REMEDY, needed=False),
    Check("torch and device", check_torch, "`pip install 'torch>=2.7'`, or run `make setup`"),
    Check("TensorBoard", check_tensorboard, "`pip install -U tensorboard`, or run `make setup`"),
    Check("densities", check_densities, "reinstall fbrl: `pip install --force-reinstall fbrl`"),
    Check(RENDERING, check_rendering, _RENDER_REMEDY, time_limit=180.0, needed=False),
)
