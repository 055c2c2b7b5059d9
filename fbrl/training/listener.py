"""What a training tells as it goes on, and how it ended."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch

from fbrl.evaluation.evaluation import Evaluation


@dataclass(frozen=True)
class TrainListener:
    """What to call as a training goes on; by default nothing, but for the warnings.

    Attributes:
        on_start: With the run's directory, the device, and the frames that were done before, once
            they are there.
        on_metrics: With the frames done and the metrics of each iteration.
        on_evaluation: With ``"untrained"``, ``"current"`` or ``"trained"``, matches done and
            matches wanted.
        on_postponed: When a signal has to wait until an update is finished.
        on_warning: With one line about what goes wrong without ending the training; by default
            a Python warning.
        on_hang: With one line when the engine hangs, in a thread of its own, just before the
            process is ended; by default it is printed on stderr.
    """

    on_start: Callable[[Path, torch.device, int], None] = lambda run_dir, device, frames: None
    on_metrics: Callable[[int, Mapping[str, float]], None] = lambda frames, metrics: None
    on_evaluation: Callable[[str, int, int], None] = lambda which, done, wanted: None
    on_postponed: Callable[[], None] = lambda: None
    on_warning: Callable[[str], None] = lambda line: warnings.warn(line, stacklevel=2)
    on_hang: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True)


@dataclass(frozen=True)
class TrainResult:
    """How a training ended.

    Attributes:
        run_dir: Where everything is.
        frames: Frames trained on.
        interrupted: A signal stopped it before its end.
        untrained: The evaluation before the training, where one was asked for.
        trained: The evaluation after it, unless it was interrupted or none was asked for.
    """

    run_dir: Path
    frames: int
    interrupted: bool
    untrained: Evaluation | None
    trained: Evaluation | None
