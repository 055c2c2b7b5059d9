"""Matches as the engine itself draws them, off-screen and in a process of its own.

The engine can draw in one instance of a process only, takes five to fifteen seconds to set that up,
and asks the system's graphics for much.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Generator, Sequence

import numpy as np

SECONDS_OF_PATIENCE = 180.0
"""How long is waited for the next picture; the first one takes five to fifteen seconds."""

_REMEDY = (
    "Rendering needs fbrl-engine-render, which `make setup` builds, and OpenGL: `sudo apt-get "
    "install libegl1 libegl-mesa0 libgl1-mesa-dri`; `fbrl-doctor` checks it."
)


class RenderingError(RuntimeError):
    """Raised where the engine's rendering can't be had, or shows another match."""


class EnginePictures:
    """Plays matches and draws pictures of ``width`` x ``height`` pixels, in a process of its own.

    As a context manager it ends the process, which otherwise ends with this one.

    Examples:
        >>> with EnginePictures(320, 180) as pictures:
        ...     ((positions, picture),) = pictures.play(("academy_corner", 1, 2))
        >>> picture.shape
        (180, 320, 3)
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._process: subprocess.Popen[str] | None = None
        self._resources = contextlib.ExitStack()

    def __enter__(self) -> EnginePictures:
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
        self._pictures, for_child = os.pipe()
        self._resources.callback(os.close, self._pictures)
        self._errors = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115
        self._resources.enter_context(self._errors)
        arguments = map(str, (self.width, self.height, for_child))
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "fbrl.envs.render_process", *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
                text=True,
                # A file of the user's working directory must not be imported in a module's place.
                env={**os.environ, "PYTHONSAFEPATH": "1"},
                pass_fds=(for_child,),
                # Ctrl-C is answered here, not by C++ code in the middle of a picture.
                start_new_session=True,
            )
        finally:
            os.close(for_child)
        # Closes its standard input too.
        self._resources.enter_context(self._process)
        self._resources.callback(self._process.kill)

    def play(
        self,
        episode: tuple[str, int, int] | None,
        actions: Sequence[int] = (),
        frame_skip: int = 1,
        *,
        every: bool = False,
    ) -> Generator[tuple[np.ndarray, np.ndarray], None, None]:
        """Begins an episode, or goes on with the last one, and draws what it comes to.

        Args:
            episode: What :func:`fbrl.envs.engine.build_scenario` takes; ``None`` to go on.
            actions: What is played, indices in [0, 19].
            frame_skip: Steps of gfootball for each.
            every: Draw each state, an episode's first one included, instead of the last alone.

        Yields:
            Positions, float32 (3 + 2 * players,): x, y and z of the ball, then x and y of each
            player of the left and of the right team; and the picture, red, green and blue, uint8 of
            shape (height, width, 3).

        Raises:
            RenderingError: The process ended, or hangs.
        """
        self.start()
        try:
            assert self._process is not None
            assert self._process.stdin is not None
            request = {
                "episode": episode,
                "actions": list(actions),
                "frame_skip": frame_skip,
                "every": every,
            }
            try:
                self._process.stdin.write(json.dumps(request) + "\n")
                self._process.stdin.flush()
            except OSError as error:
                raise self._ended() from error
            expected = len(actions) + (episode is not None) if every else 1
            for _ in range(expected):
                (count,) = np.frombuffer(self._receive(4), np.int32)
                positions = np.frombuffer(self._receive(4 * int(count)), np.float32)
                picture = np.frombuffer(self._receive(self.height * self.width * 3), np.uint8)
                yield positions, picture.reshape(self.height, self.width, 3)
        except BaseException:
            # Also where the caller wants no more pictures: the rest would be taken for the next.
            self.close()
            raise

    def _receive(self, size: int) -> bytearray:
        received = bytearray()
        while len(received) < size:
            ready, _, _ = select.select([self._pictures], [], [], SECONDS_OF_PATIENCE)
            if not ready:
                raise RenderingError(
                    f"The engine has drawn nothing for {SECONDS_OF_PATIENCE:g} s. {_REMEDY}"
                )
            part = os.read(self._pictures, size - len(received))
            if not part:
                raise self._ended()
            received += part
        return received

    def _ended(self) -> RenderingError:
        assert self._process is not None
        code = self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().strip().splitlines() or ["it said nothing"]
        ending = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return RenderingError(
            f"The process in which the engine renders ended with {ending}: {lines[-1]}. {_REMEDY}"
        )
