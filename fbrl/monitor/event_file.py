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

from fbrl.files.appended_file import AppendedFile

RGB = 3
"""TensorBoard's number for a picture's colour space."""

_PREFIX = "events.out.tfevents."


class EventFile:
    """Appends summaries to an event file that TensorBoard reads.

    Instead of ``SummaryWriter``, whose thread prints a traceback of its own when a write fails:
    here each method raises the ``OSError``, and what it was given is written with what is added
    next. It also takes one event for all the scalars of an iteration, and puts hyperparameters into
    the run itself, where ``SummaryWriter`` makes a run below it.

    Args:
        run_dir: The run's directory; it must exist.
    """

    def __init__(self, run_dir: Path) -> None:
        # TensorBoard reads a run's files in the order of their names, which begin with a second.
        earlier = [path.name.removeprefix(_PREFIX)[:10] for path in run_dir.glob(_PREFIX + "*")]
        later = [int(second) + 1 for second in earlier if second.isdecimal()]
        second = max([int(time.time()), *later])
        path = run_dir / f"{_PREFIX}{second:010d}.{socket.gethostname()}.{os.getpid()}"
        path.touch(exist_ok=False)
        self._wall_time = 0.0
        self._file = AppendedFile(path, self._record(file_version="brain.Event:2"))

    def add_scalars(self, values: Mapping[str, float], frames: int) -> None:
        """Adds scalars by their names."""
        scalars = [Summary.Value(tag=name, simple_value=value) for name, value in values.items()]
        self.add(step=frames, summary=Summary(value=scalars))

    def add_image(self, name: str, encoded: bytes, frames: int) -> None:
        """Adds a PNG, JPEG or GIF file; TensorBoard shows an animated GIF as a video."""
        with PIL.Image.open(io.BytesIO(encoded)) as opened:
            width, height = opened.size
        image = Summary.Image(
            height=height, width=width, colorspace=RGB, encoded_image_string=encoded
        )
        self.add(step=frames, summary=Summary(value=[Summary.Value(tag=name, image=image)]))

    def add_restart(self, frames: int) -> None:
        """Takes back what earlier files of the run have from a number of frames on.

        This is what ``SummaryWriter(purge_step=frames)`` writes.
        """
        self.add(step=frames, session_log=SessionLog(status=SessionLog.START))

    def add(self, **event: Any) -> None:
        """Adds an event with these fields, such as ``step`` and ``summary``."""
        self._file.append(self._record(**event))

    def _record(self, **event: Any) -> bytes:
        # A clock that is set back would make TensorBoard's relative times negative.
        self._wall_time = max(self._wall_time, time.time())
        record = io.BytesIO()
        RecordWriter(record).write(Event(wall_time=self._wall_time, **event).SerializeToString())
        return record.getvalue()
