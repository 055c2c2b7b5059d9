"""TensorBoard's event file of a run."""

from __future__ import annotations

import io
import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import PIL.Image
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter
from torch.utils.tensorboard.summary import custom_scalars, hparams

from fbrl.files.appended_file import AppendedFile

RGB = 3
"""TensorBoard's number for a picture's colour space."""


_PREFIX = "events.out.tfevents."


class EventFile:
    """Appends summaries to an event file that TensorBoard reads.

    Instead of ``SummaryWriter``, whose thread prints a traceback of its own when a write fails:
    here the caller gets the error, and what could not be written is written later. It also takes
    one event for all the scalars of an iteration, and puts hyperparameters into the run itself,
    where ``SummaryWriter`` makes a run below it.

    Args:
        run_dir: The run's directory; it must exist.
    """

    def __init__(self, run_dir: Path) -> None:
        name = f"{_PREFIX}{_next_second(run_dir):010d}.{socket.gethostname()}.{os.getpid()}"
        (run_dir / name).touch(exist_ok=False)
        self._wall_time = 0.0
        self._file = AppendedFile(run_dir / name, self._record(file_version="brain.Event:2"))

    def add_scalars(self, values: Mapping[str, float], frames: int) -> None:
        """Adds scalars by their names.

        Raises:
            OSError: The file can't be written now; so do all other methods. What they were given
                is written with what is added next.
        """
        scalars = [Summary.Value(tag=name, simple_value=value) for name, value in values.items()]
        self._add(Summary(value=scalars), frames)

    def add_image(self, name: str, encoded: bytes, frames: int) -> None:
        """Adds a picture.

        Args:
            name: Its name.
            encoded: A PNG, JPEG or GIF file; TensorBoard shows an animated GIF as a video.
            frames: Its place on the x axis.
        """
        with PIL.Image.open(io.BytesIO(encoded)) as opened:
            width, height = opened.size
        image = Summary.Image(
            height=height, width=width, colorspace=RGB, encoded_image_string=encoded
        )
        self._add(Summary(value=[Summary.Value(tag=name, image=image)]), frames)

    def add_layout(self, layout: Mapping[str, Mapping[str, Any]]) -> None:
        """Adds the charts of the page Custom Scalars, as ``SummaryWriter.add_custom_scalars``."""
        self._add(custom_scalars(layout), 0)

    def add_hyperparameters(
        self, values: Mapping[str, float | str], metrics: tuple[str, ...]
    ) -> None:
        """Adds what the run's row on the page HParams shows.

        Args:
            values: The hyperparameters.
            metrics: Names of the scalars whose last values are shown beside them.
        """
        experiment, start, _ = hparams(dict(values), dict.fromkeys(metrics))
        self._add(experiment, 0)
        self._add(start, 0)

    def add_restart(self, frames: int) -> None:
        """Takes back what earlier files of the run have from a number of frames on.

        This is what ``SummaryWriter(purge_step=frames)`` writes.
        """
        restart = SessionLog(status=SessionLog.START)
        self._file.append(self._record(step=frames, session_log=restart))

    def _add(self, summary: Summary, frames: int) -> None:
        self._file.append(self._record(step=frames, summary=summary))

    def _record(self, **event: Any) -> bytes:
        # A clock that is set back would make TensorBoard's relative times negative.
        self._wall_time = max(self._wall_time, time.time())
        record = io.BytesIO()
        RecordWriter(record).write(Event(wall_time=self._wall_time, **event).SerializeToString())
        return record.getvalue()


def _next_second(run_dir: Path) -> int:
    """The time, or a later one: TensorBoard reads a run's files in the order of their names."""
    seconds = [path.name.removeprefix(_PREFIX)[:10] for path in run_dir.glob(_PREFIX + "*")]
    return max([int(time.time()), *(int(text) + 1 for text in seconds if text.isdecimal())])
