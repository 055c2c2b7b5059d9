"""Frames to a video file, MP4 or GIF by its name, in one piece or not at all."""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fbrl.checks.extras import MissingExtraError, missing_packages

ENDINGS = (".mp4", ".gif")

_PACKAGES = ("mplsoccer", "imageio_ffmpeg", "cv2")

# Players take colours without a tag for those of BT.709 or BT.601, as they like.
_TAGGED = ("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709")
_H264 = (
    *("-vf", "scale=out_color_matrix=bt709", "-c:v", "libx264", "-pix_fmt", "yuv420p"),
    *_TAGGED,
    *("-preset", "veryfast", "-crf", "20", "-movflags", "+faststart"),
)
_LOSSLESS = ("-c:v", "libx264rgb", "-preset", "ultrafast", "-crf", "0")
_PALETTE = "palettegen=max_colors=160:stats_mode=full"
# Dithering would change every pixel in every frame, and so make the file many times as large.
_USE_PALETTE = "[0:v][1:v]paletteuse=dither=none:diff_mode=rectangle"


def missing_video_packages() -> list[str]:
    """Packages that drawing and filming matches need, and that are not installed."""
    return missing_packages(_PACKAGES)


def check_video_packages() -> None:
    """Raises :class:`fbrl.checks.extras.MissingExtraError` where such packages are missing."""
    missing = missing_video_packages()
    if missing:
        raise MissingExtraError("Videos", missing, "analysis")


def check_video_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a video can be written to it.

    Raises:
        ValueError: It is a directory, its directory is missing, or it has an unknown ending.
        OSError: Its directory can't be written to.
    """
    path = Path(path)
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(f"{path}: a video's name must end in {' or '.join(ENDINGS)}.")
    if path.is_dir():
        raise ValueError(f"{path} is a directory; give the name of a file.")
    if not path.absolute().parent.is_dir():
        raise ValueError(f"There is no directory {path.parent} to write {path.name} into.")
    if not os.access(path.absolute().parent, os.W_OK):
        raise PermissionError(f"The directory {path.parent} can't be written to.")
    return path


def write_video(
    path: str | os.PathLike[str], frames: Iterable[np.ndarray], fps: float = 10.0
) -> int:
    """Writes frames as they come.

    Args:
        path: ``.mp4`` (H.264 in yuv420p, which browsers play) or ``.gif``, repeated for ever.
        frames: uint8 (height, width, 3), red, green and blue; all of one size, even both ways.
        fps: Frames per second, positive; a match has 10.

    Returns:
        The number of frames.

    Raises:
        ValueError: The ending is unknown, there are no frames, their sizes differ or are odd.
        MissingExtraError: imageio-ffmpeg is missing.
        OSError: The file can't be written.

    Whatever goes wrong, also in the iterable of frames, leaves no file behind and an older one
    untouched.
    """
    path = check_video_path(path)
    is_gif = path.suffix.lower() == ".gif"
    # Next to the file, so that it is renamed within one file system.
    # From the root, so that ffmpeg takes no name for an option or the address of a server.
    with tempfile.TemporaryDirectory(prefix=".fbrl-video-", dir=path.parent.resolve()) as folder:
        result = Path(folder, "video.mp4")
        count = _encode(result, frames, fps, _LOSSLESS if is_gif else _H264)
        if is_gif:
            result = _convert_to_gif(result)
        result.replace(path)
    return count


def _encode(path: Path, frames: Iterable[np.ndarray], fps: float, options: Sequence[str]) -> int:
    count = 0
    with contextlib.ExitStack() as stack:
        for frame in frames:
            if not count:
                shape = _check_shape(frame)
                size = f"{shape[1]}x{shape[0]}"
                raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-")
                encoder = stack.enter_context(_Encoder([*raw, *options, str(path)]))
            if frame.shape != shape:
                raise ValueError(f"Frame {count} is of shape {frame.shape}, the first of {shape}.")
            encoder.write(np.ascontiguousarray(frame).data)
            count += 1
        if not count:
            raise ValueError("There are no frames to make a video of.")
        encoder.finish()
    return count


def _check_shape(frame: np.ndarray) -> tuple[int, ...]:
    if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8:
        raise ValueError(f"Frames are {frame.dtype} of shape {frame.shape}, not uint8 (h, w, 3).")
    if frame.shape[0] % 2 or frame.shape[1] % 2:
        raise ValueError(f"Frames are of shape {frame.shape}; H.264 needs even sizes.")
    return frame.shape


def _convert_to_gif(video: Path) -> Path:
    """One palette for all frames, which needs a look at all of them before the first is written."""
    palette, gif = video.with_name("palette.png"), video.with_name("video.gif")
    passes: list[list[str | Path]] = [
        ["-i", video, "-vf", _PALETTE, palette],
        ["-i", video, "-i", palette, "-filter_complex", _USE_PALETTE, gif],
    ]
    for arguments in passes:
        with _Encoder(arguments) as encoder:
            encoder.finish()
    return gif


class _Encoder:
    """ffmpeg as imageio-ffmpeg brings it along, with its exit code and its complaints heeded."""

    def __init__(self, arguments: Sequence[str | Path]) -> None:
        try:
            from imageio_ffmpeg import get_ffmpeg_exe
        except ImportError as error:
            raise MissingExtraError("Videos", ["imageio_ffmpeg"], "analysis") from error
        self._errors = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115
        self._process = subprocess.Popen(
            [get_ffmpeg_exe(), "-v", "error", *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            # Ctrl-C is answered here.
            start_new_session=True,
        )

    def __enter__(self) -> _Encoder:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        with contextlib.suppress(OSError):
            self._process.communicate()
        self._errors.close()

    def write(self, pixels: memoryview) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(pixels)
        except OSError:
            self.finish()

    def finish(self) -> None:
        """Waits for the file to be whole."""
        with contextlib.suppress(OSError):
            self._process.communicate()
        if self._process.returncode != 0:
            self._errors.seek(0)
            lines = self._errors.read().strip().splitlines() or ["it said nothing"]
            raise OSError(
                f"The video can't be written: ffmpeg ended with {self._process.returncode}, "
                f"{lines[-1]}."
            )
