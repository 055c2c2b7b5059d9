"""A recorded match as the engine itself draws it."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator

import numpy as np

from fbrl.watch.recording import MatchRecording

SECONDS_OF_PATIENCE = 180.0
"""How long is waited for the next picture; the first one takes five to fifteen seconds."""

_REMEDY = (
    "Rendering without a display needs `sudo apt-get install libegl1 libegl-mesa0 "
    "libgl1-mesa-dri`; `fbrl-doctor` checks it."
)


class RenderingError(RuntimeError):
    """Raised where the engine's rendering can't be had, or shows another match."""


class EngineView:
    """Draws recorded matches with the engine, in a process of its own.

    The match is played once more from its seed and its actions; that every player, and the ball, is
    where the recording has it is checked at every step.

    Args:
        width: Of the frames, pixels, even.
        height: Likewise.

    As a context manager it ends the process, which otherwise ends with this one.

    Examples:
        A video of matches in three dimensions::

            with EngineView(width=640, height=360) as view:
                for match in matches:
                    write_video("match.mp4", view.frames(match))
    """

    def __init__(self, width: int = 640, height: int = 360) -> None:
        self.width, self.height = width, height
        self._process: subprocess.Popen[str] | None = None
        self._resources = contextlib.ExitStack()

    def __enter__(self) -> EngineView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the process; the next match starts another one."""
        self._resources.close()
        self._process = None

    def start(self) -> None:
        """Starts the process, unless it runs; the engine is set up while others go on."""
        if self._process is not None:
            return
        self._frames, for_child = os.pipe()
        self._resources.callback(os.close, self._frames)
        self._errors = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115
        self._resources.enter_context(self._errors)
        # A file of the user's working directory must not be imported in a module's place.
        environment = {**os.environ, "PYTHONSAFEPATH": "1"}
        # Headless means that no X server is asked.
        environment.pop("DISPLAY", None)
        program = [sys.executable, "-m", "fbrl.watch.render_process"]
        try:
            self._process = subprocess.Popen(
                [*program, str(self.width), str(self.height), str(for_child)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
                text=True,
                env=environment,
                pass_fds=(for_child,),
                # Ctrl-C is answered here, not by C++ code in the middle of a picture.
                start_new_session=True,
            )
        finally:
            os.close(for_child)
        # Closes its standard input too.
        self._resources.enter_context(self._process)
        self._resources.callback(self._process.kill)

    def frames(self, recording: MatchRecording) -> Iterator[np.ndarray]:
        """Draws every state of a match, the first one included.

        Yields:
            Red, green and blue, uint8 (height, width, 3).

        Raises:
            RenderingError: The process ended, hangs, or plays another match than was recorded.
        """
        self.start()
        try:
            yield from self._receive_frames(recording)
        except BaseException:
            # Also where the caller wants no more frames: what is left of them would be taken for
            # the next match.
            self.close()
            raise

    def _receive_frames(self, recording: MatchRecording) -> Iterator[np.ndarray]:
        self._send(recording)
        for index, positions in enumerate(_recorded_positions(recording)):
            played = np.frombuffer(self._receive(positions.nbytes), np.float32)
            picture = self._receive(self.height * self.width * 3)
            if not np.array_equal(played, positions):
                raise RenderingError(
                    f"The engine does not play {recording.scenario} with seed "
                    f"{recording.engine_seed} as it was recorded: at step {index} the positions "
                    "differ. Record it anew with the engine that is installed."
                )
            yield np.frombuffer(picture, np.uint8).reshape(self.height, self.width, 3)

    def _send(self, recording: MatchRecording) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        match = {
            "scenario": recording.scenario,
            "engine_seed": recording.engine_seed,
            "episode_number": recording.episode_number,
            "actions": recording.actions.tolist(),
        }
        try:
            self._process.stdin.write(json.dumps(match) + "\n")
            self._process.stdin.flush()
        except OSError as error:
            raise self._ended() from error

    def _receive(self, size: int) -> bytes:
        received = bytearray()
        while len(received) < size:
            ready, _, _ = select.select([self._frames], [], [], SECONDS_OF_PATIENCE)
            if not ready:
                raise RenderingError(
                    f"The engine has drawn nothing for {SECONDS_OF_PATIENCE:g} s. {_REMEDY}"
                )
            part = os.read(self._frames, size - len(received))
            if not part:
                raise self._ended()
            received += part
        return bytes(received)

    def _ended(self) -> RenderingError:
        assert self._process is not None
        code = self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().strip().splitlines() or ["it said nothing"]
        ending = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return RenderingError(
            f"The process in which the engine renders ended with {ending}: {lines[-1]}. {_REMEDY}"
        )


def _recorded_positions(recording: MatchRecording) -> Iterator[np.ndarray]:
    """What :func:`fbrl.envs.rendering.render_match` yields as positions, as it was recorded."""
    observations = recording.observations
    for index in range(recording.num_steps + 1):
        teams = [
            observations[team][index][observations[f"{team}_roles"][index] != -1].ravel()
            for team in ("left_team", "right_team")
        ]
        yield np.concatenate([observations["ball"][index], *teams]).astype(np.float32)
