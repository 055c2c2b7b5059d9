"""Checks of an installation, part by part, each with a remedy for what it finds wrong.

Each check runs in a Python process of its own with a time limit, since a broken compiled library
may end the interpreter or hang, and one broken part shall not hide the others. ``python -m
fbrl.doctor NAME`` is such a process; users call the command ``fbrl-doctor``. Importing this module
imports none of what is checked.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Status = Literal["ok", "warn", "fail"]

# The engine prints to the same stream, without a newline at times.
_MARKER = "FBRL-DOCTOR-RESULT "

_REBUILD = "rebuild the environment: `make clean && make setup`"
_ENGINE_REMEDY = "run `make setup` in fbrl's repository, or install what `make engine-wheel` made"
_TCMALLOC_REMEDY = "`sudo apt-get install libtcmalloc-minimal4`"
_RENDER_REMEDY = "`sudo apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri` (only videos need it)"


class CheckError(Exception):
    """What is wrong, what mends it, and ``"warn"`` for what works less well."""

    def __init__(self, detail: str, remedy: str, status: Status = "fail") -> None:
        super().__init__(detail)
        self.detail, self.remedy, self.status = detail, remedy, status


@dataclass(frozen=True)
class Check:
    """A part of the installation that can be checked.

    Its function returns a line of detail, or raises; :class:`CheckError` where it knows the remedy.
    The remedy here is for failures that it doesn't foresee, crashes included, and for more than
    ``time_limit`` seconds. What training doesn't need earns a warning where it fails.
    """

    name: str
    function: Callable[[], str]
    remedy: str
    time_limit: float = 60.0
    needed: bool = True


@dataclass(frozen=True)
class CheckResult:
    """What a check found: a line of detail, a remedy unless all is well, and how long it took."""

    name: str
    status: Status
    detail: str
    remedy: str = ""
    seconds: float = 0.0


def check_packages() -> str:
    """Whether the packages that fbrl declares are installed, in versions that it works with."""
    from packaging.requirements import Requirement

    problems = []
    for line in importlib.metadata.requires("fbrl") or ():
        requirement = Requirement(line)
        if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
            continue
        version = _installed_version(requirement.name)
        if version is None:
            problems.append(f"{requirement.name} is missing")
        elif not requirement.specifier.contains(version, prereleases=True):
            problems.append(f"{requirement.name} {version} is not {requirement.specifier}")
    if problems:
        raise CheckError(", ".join(problems), "run `make setup`, or `pip install -U fbrl`")
    return f"Python {platform.python_version()} at {sys.executable}, all packages fit"


def _installed_version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


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
            python = f"{platform.python_implementation()} {platform.python_version()}"
            raise CheckError(
                f"the installed engine isn't for {python} on {platform.machine()}", _ENGINE_REMEDY
            ) from error
        raise
    return f"fbrl-engine {_installed_version('fbrl-engine') or 'from a folder'}"


def _check_match() -> str:
    """Plays a few steps of a real match."""
    from fbrl.envs import FootballEnv

    env = FootballEnv("academy_empty_goal_close")
    before, _ = env.reset(seed=0)
    right, steps = 5, 10
    started = time.perf_counter()
    for _ in range(steps):
        after, *_ = env.step(right)
    milliseconds = (time.perf_counter() - started) / steps * 1000
    if (before["ball"] == after["ball"]).all():
        raise CheckError(f"the ball hasn't moved within {steps} steps of a match", _REBUILD)
    return f"{steps} steps of academy_empty_goal_close, {milliseconds:.1f} ms each"


def _check_allocator() -> str:
    """Whether the commands that play matches use tcmalloc."""
    from fbrl import allocator

    name = allocator.TCMALLOC
    if allocator.find_tcmalloc() is None:
        detail = f"{name} isn't installed, and matches are slower without it"
        raise CheckError(detail, _TCMALLOC_REMEDY, "warn")
    if reason := allocator.reason_against_tcmalloc(os.environ):
        return f"left as it is, because of {reason}"
    process = subprocess.run(
        [sys.executable, "-c", "print(open('/proc/self/maps').read())"],
        env=allocator.environment_with_tcmalloc(os.environ),
        capture_output=True,
        text=True,
        check=False,
    )
    if name.partition(".")[0] not in process.stdout:
        problem = " ".join(process.stderr.split())
        raise CheckError(f"{name} can't be preloaded: {problem}", _TCMALLOC_REMEDY, "warn")
    return f"{name} is preloaded by the commands that play matches"


def _check_torch() -> str:
    """Computes on the device that training would choose."""
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


def _check_tensorboard() -> str:
    """Writes an event file and reads it back."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from torch.utils.tensorboard import SummaryWriter

    with tempfile.TemporaryDirectory(prefix="fbrl-doctor-") as directory:
        with SummaryWriter(directory) as writer:
            writer.add_scalar("doctor/check", 0.5, global_step=3)
        events = EventAccumulator(directory).Reload().Scalars("doctor/check")
    if [(event.step, event.value) for event in events] != [(3, 0.5)]:
        detail = f"an event file was written and reads back as {events}"
        raise CheckError(detail, "`pip install -U tensorboard`")
    return f"tensorboard {importlib.metadata.version('tensorboard')}, event file written and read"


def _check_densities() -> str:
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


RENDERING = "headless rendering"

CHECKS: tuple[Check, ...] = (
    Check("Python packages", check_packages, "run `make setup`"),
    Check("engine import", check_engine, _ENGINE_REMEDY),
    Check("match step", _check_match, f"mend the engine import first; else {_REBUILD}"),
    Check("allocator", _check_allocator, _TCMALLOC_REMEDY, needed=False),
    Check("torch and device", _check_torch, "`pip install 'torch>=2.7'`, or run `make setup`"),
    Check("TensorBoard", _check_tensorboard, "`pip install -U tensorboard`, or run `make setup`"),
    Check("densities", _check_densities, "reinstall fbrl: `pip install --force-reinstall fbrl`"),
    Check(RENDERING, check_rendering, _RENDER_REMEDY, time_limit=180.0, needed=False),
)


def run_checks(checks: Iterable[Check]) -> Iterator[CheckResult]:
    """Runs checks side by side; yields their results in the order of the checks."""
    pool = ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1))
    try:
        yield from pool.map(run_check, checks)
    finally:
        # After an interruption no other check is begun.
        pool.shutdown(cancel_futures=True)


def run_check(check: Check) -> CheckResult:
    """Runs a check in a process of its own; never raises for what the check does."""
    started = time.perf_counter()
    status, detail, remedy = _answer_of_process(check)
    if status == "fail" and not check.needed:
        status = "warn"
    seconds = round(time.perf_counter() - started, 2)
    return CheckResult(check.name, status, detail, remedy, seconds)


def _answer_of_process(check: Check) -> tuple[Status, str, str]:
    # A file of the user's working directory must not be imported in a module's place.
    environment = {**os.environ, "PYTHONSAFEPATH": "1"}
    # Headless means that no X server is asked, a dead one of an old login least of all.
    environment.pop("DISPLAY", None)
    try:
        process = subprocess.run(
            [sys.executable, "-m", "fbrl.doctor", check.name],
            capture_output=True,
            text=True,
            errors="replace",
            env=environment,
            timeout=check.time_limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "fail", f"no answer within {check.time_limit:g} s", check.remedy
    if match := re.search(re.escape(_MARKER) + r"(\[.*\])", process.stdout):
        status, detail, remedy = json.loads(match[1])
        return status, detail, remedy
    last_line = (process.stderr.strip() or "no output").splitlines()[-1]
    if process.returncode < 0:
        ending = f"crashed with {signal.Signals(-process.returncode).name}"
    else:
        ending = f"ended with status {process.returncode}"
    return "fail", f"{ending}: {last_line}", check.remedy


def _answer(check: Check) -> tuple[Status, str, str]:
    """Status, detail and remedy, in the process in which the check runs."""
    try:
        return "ok", check.function(), ""
    except CheckError as error:
        return error.status, error.detail, error.remedy
    except Exception as error:
        # What an error was raised from names the missing thing; its own words say what to do.
        cause = error.__cause__ or error
        return "fail", f"{type(cause).__name__}: {' '.join(str(cause).split())}", check.remedy


def installation_works(results: Iterable[CheckResult]) -> bool:
    """Whether nothing that training needs has failed."""
    return all(result.status != "fail" for result in results)


if __name__ == "__main__":
    _check = next(check for check in CHECKS if check.name == sys.argv[1])
    print(f"\n{_MARKER}{json.dumps(_answer(_check))}", flush=True)
    # Some graphics drivers crash while the process is taken down, after the answer.
    os._exit(0)
