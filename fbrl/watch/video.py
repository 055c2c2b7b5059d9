"""Frames to a video file, MP4 or GIF by its name, in one piece or not at all."""

from __future__ import annotations

import itertools
import os
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fbrl.checks import MissingExtraError, missing_packages

ENDINGS = (".mp4", ".gif")

_PACKAGES = ("mplsoccer", "imageio_ffmpeg", "cv2")

# Players take colours without a tag for those of BT.709 or BT.601, as they like.
_H264 = (
    "-vf scale=out_color_matrix=bt709 -c:v libx264 -pix_fmt yuv420p -colorspace bt709 "
    "-color_primaries bt709 -color_trc bt709 -preset veryfast -crf 20 -movflags +faststart"
)
_LOSSLESS = "-c:v libx264rgb -preset ultrafast -crf 0"
# One palette for all frames, and so two readings of the video: the first ends before the second
# begins, so that no frame waits in memory. Dithering would change every pixel in every frame, and
# make the file many times as large.
_WITH_PALETTE = (
    "[0:v]palettegen=max_colors=160:stats_mode=full[palette];"
    "[1:v][palette]paletteuse=dither=none:diff_mode=rectangle"
)


def missing_video_packages() -> list[str]:
    """Packages that drawing and filming matches need, and that are not installed."""
    return missing_packages(_PACKAGES)


def check_video_packages() -> None:
    """Raises :class:`fbrl.checks.MissingExtraError` where such packages are missing."""
    missing = missing_video_packages()
    if missing:
        raise MissingExtraError("Videos", missing, "analysis")


def check_video_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a video can be written to it.

    Raises:
        ValueError: It is a directory, its directory is missing, or it has an unknown ending.
    """
    path = Path(path)
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(f"{path}: a video's name must end in {' or '.join(ENDINGS)}.")
    if path.is_dir():
        raise ValueError(f"{path} is a directory; give the name of a file.")
    if not path.absolute().parent.is_dir():
        raise ValueError(f"There is no directory {path.parent} to write {path.name} into.")
    return path


def write_video(
    path: str | os.PathLike[str], frames: Iterable[np.ndarray], fps: float = 10.0
) -> int:
    """Writes frames as they come.

    Args:
        path: ``.mp4`` (H.264 in yuv420p, which browsers play) or ``.gif``, repeated for ever.
        frames: uint8 (height, width, 3), red, green and blue; all of one size, even both ways.
        fps: Frames per second, positive; a match has 10, fewer with a frame skip.

    Returns:
        The number of frames.

    Raises:
        ValueError: The ending is unknown, there are no frames, their sizes differ or are odd.
        MissingExtraError: imageio-ffmpeg is missing.
        OSError: The file can't be written.

    Whatever goes wrong leaves no file behind, and an older one untouched.
    """
    path = check_video_path(path)
    is_gif = path.suffix.lower() == ".gif"
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise ValueError("There are no frames to make a video of.")
    if first.ndim != 3 or first.shape[2] != 3 or first.dtype != np.uint8:
        raise ValueError(f"Frames are {first.dtype} of shape {first.shape}, not uint8 (h, w, 3).")
    height, width, _ = first.shape
    if height % 2 or width % 2:
        raise ValueError(f"Frames are of shape {first.shape}; H.264 needs even sizes.")
    raw = f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {fps} -i -".split()
    # Next to the file, so that it is renamed within one file system.
    # From the root, so that ffmpeg takes no name for an option or the address of a server.
    with tempfile.TemporaryDirectory(prefix=".fbrl-video-", dir=path.parent.resolve()) as folder:
        video, gif = Path(folder, "video.mp4"), Path(folder, "video.gif")
        encoding = (_LOSSLESS if is_gif else _H264).split()
        count = _run_ffmpeg([*raw, *encoding, video], itertools.chain([first], frames))
        if is_gif:
            _run_ffmpeg(["-i", video, "-i", video, "-filter_complex", _WITH_PALETTE, gif])
        (gif if is_gif else video).replace(path)
    return count


def _run_ffmpeg(arguments: Sequence[str | Path], frames: Iterable[np.ndarray] = ()) -> int:
    """Runs ffmpeg as imageio-ffmpeg brings it along, on frames of one shape; returns their number.

    Its own ``write_frames`` doesn't look at the exit code, which is where a full disk shows.
    """
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError as error:
        raise MissingExtraError("Videos", ["imageio_ffmpeg"], "analysis") from error
    line = [get_ffmpeg_exe(), "-v", "error", *map(str, arguments)]
    count, shape = 0, None
    with tempfile.TemporaryFile("w+", errors="replace") as complaints:
        # In a session of its own: Ctrl-C is answered here.
        process = subprocess.Popen(
            line, stdin=subprocess.PIPE, stderr=complaints, start_new_session=True
        )
        assert process.stdin is not None
        try:
            for count, frame in enumerate(frames, start=1):
                shape = shape or frame.shape
                if frame.shape != shape:
                    raise ValueError(
                        f"Frame {count - 1} is of shape {frame.shape}, the first of {shape}."
                    )
                try:
                    process.stdin.write(np.ascontiguousarray(frame).data)
                except OSError:  # it has ended, and said why
                    break
            process.communicate()
        except BaseException:
            process.kill()
            process.communicate()
            raise
        if process.returncode != 0:
            complaints.seek(0)
            lines = complaints.read().strip().splitlines() or ["it said nothing"]
            raise OSError(
                f"The video can't be written: ffmpeg ended with {process.returncode}, {lines[-1]}."
            )
    return count
