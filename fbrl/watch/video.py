"""Frames to a video file, MP4 or GIF by its name, in one piece or not at all."""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

ENDINGS = (".mp4", ".gif")

_H264 = {
    "codec": "libx264",
    "pixelformat": "yuv420p",
    "output_params": ["-preset", "veryfast", "-crf", "20", "-movflags", "+faststart"],
}
_LOSSLESS = {
    "codec": "libx264rgb",
    "pixelformat": "rgb24",
    "output_params": ["-preset", "ultrafast", "-crf", "0"],
}
_PALETTE = "palettegen=max_colors=160:stats_mode=full"
# Dithering would change every pixel in every frame, and so make the file many times as large.
_USE_PALETTE = "[0:v][1:v]paletteuse=dither=none:diff_mode=rectangle"


class MissingExtraError(ImportError):
    """Raised where drawing or video writing is asked for and its libraries are not installed."""

    def __init__(self, error: ImportError) -> None:
        super().__init__(
            f"Videos need what is not installed ({error}): `pip install 'fbrl[analysis]'`."
        )


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
        ValueError: The ending is unknown, there are no frames, or their sizes differ.
        MissingExtraError: imageio or its ffmpeg is missing.
        OSError: The file can't be written.

    Whatever goes wrong, also in the iterable of frames, leaves no file behind and an older one
    untouched.
    """
    path = check_video_path(path)
    is_gif = path.suffix.lower() == ".gif"
    # Next to the file, so that it is renamed within one file system.
    with tempfile.TemporaryDirectory(prefix=".fbrl-video-", dir=path.parent) as folder:
        result = Path(folder, "video.mp4")
        count = _encode(result, frames, fps, _LOSSLESS if is_gif else _H264)
        if is_gif:
            result = _convert_to_gif(result)
        result.replace(path)
    return count


def _encode(path: Path, frames: Iterable[np.ndarray], fps: float, options: dict[str, Any]) -> int:
    writer: Any = None
    shape = None
    count = 0
    try:
        for frame in frames:
            if writer is None:
                writer, shape = _open(path, fps, options), frame.shape
            if frame.shape != shape:
                raise ValueError(f"Frame {count} is of shape {frame.shape}, the first of {shape}.")
            writer.append_data(np.ascontiguousarray(frame))
            count += 1
    except BaseException:
        # An encoder that is broken off may complain too, which must not hide the reason.
        if writer is not None:
            with contextlib.suppress(Exception):
                writer.close()
        raise
    if writer is None:
        raise ValueError("There are no frames to make a video of.")
    writer.close()
    return count


def _open(path: Path, fps: float, options: dict[str, Any]) -> Any:
    try:
        import imageio
        import imageio_ffmpeg  # noqa: F401  (without it imageio names none of our extras)
    except ImportError as error:
        raise MissingExtraError(error) from error
    return imageio.get_writer(
        path,
        format="FFMPEG",
        fps=fps,
        quality=None,
        # imageio would otherwise scale the frames to multiples of 16 pixels.
        macro_block_size=2,
        ffmpeg_log_level="error",
        **options,
    )


def _convert_to_gif(video: Path) -> Path:
    """One palette for all frames, which needs a look at all of them before the first is written."""
    palette, gif = video.with_name("palette.png"), video.with_name("video.gif")
    _run_ffmpeg("-i", video, "-vf", _PALETTE, palette)
    _run_ffmpeg("-i", video, "-i", palette, "-filter_complex", _USE_PALETTE, gif)
    return gif


def _run_ffmpeg(*arguments: str | Path) -> None:
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-nostdin", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode != 0:
        reason = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise OSError(f"ffmpeg couldn't make the GIF: {reason[-1]}")
