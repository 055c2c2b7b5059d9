"""Video files, opened again."""

from __future__ import annotations

import resource
import signal

import imageio.v3 as iio
import numpy as np
import pytest

from fbrl.watch.video import write_video

COLOURS = [(210, 40, 40), (40, 190, 60), (50, 60, 220)]


def coloured_frames(count=9, shape=(90, 122)):
    """Frames of one colour with a white square that moves to the right."""
    for index in range(count):
        frame = np.full((*shape, 3), COLOURS[index % 3], np.uint8)
        frame[40:50, 10 * index : 10 * index + 10] = 255
        yield frame


@pytest.mark.parametrize(("name", "tolerance"), [("match.mp4", 24), ("MATCH.GIF", 6)])
def test_a_video_holds_the_frames_that_were_written(tmp_path, name, tolerance):
    assert write_video(tmp_path / name, coloured_frames()) == 9
    frames = iio.imread(tmp_path / name)
    assert frames.shape == (9, 90, 122, 3)
    for index, (frame, expected) in enumerate(zip(frames, coloured_frames(), strict=True)):
        for row, column in ((5, 5), (85, 117), (45, 10 * index + 5)):
            difference = frame[row, column].astype(int) - expected[row, column]
            assert np.abs(difference).max() <= tolerance, (index, row, column)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_an_mp4_is_what_browsers_play(tmp_path):
    write_video(tmp_path / "match.mp4", coloured_frames(), fps=25)
    metadata = iio.immeta(tmp_path / "match.mp4", plugin="FFMPEG")
    assert metadata["codec"] == "h264"
    assert metadata["pix_fmt"].startswith("yuv420p")
    assert metadata["fps"] == 25
    assert metadata["size"] == (122, 90)
    content = (tmp_path / "match.mp4").read_bytes()
    assert content.index(b"moov") < content.index(b"mdat"), "plays before it is downloaded"


def test_a_gif_is_repeated_at_its_speed(tmp_path):
    write_video(tmp_path / "match.gif", coloured_frames(), fps=20)
    metadata = iio.immeta(tmp_path / "match.gif")
    assert (metadata["loop"], metadata["duration"]) == (0, 50)


@pytest.mark.parametrize("name", ["match.mp4", "match.gif"])
@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt])
def test_a_failure_leaves_the_older_file_and_nothing_else(tmp_path, name, failure):
    def frames():
        yield from coloured_frames(4)
        raise failure("in the middle")

    (tmp_path / name).write_text("older")
    with pytest.raises(failure, match="in the middle"):
        write_video(tmp_path / name, frames())
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "older"


def test_what_can_be_no_video_is_refused(tmp_path):
    (tmp_path / "folder.mp4").mkdir()
    odd = [np.zeros((10, 10, 3), np.uint8), np.zeros((12, 10, 3), np.uint8)]
    for name, frames, message in (
        ("match.avi", coloured_frames(), "must end in .mp4 or .gif"),
        ("nowhere/match.mp4", coloured_frames(), "no directory"),
        ("folder.mp4", coloured_frames(), "is a directory"),
        ("empty.mp4", [], "no frames"),
        ("odd.mp4", coloured_frames(shape=(91, 122)), "even sizes"),
        ("floats.mp4", [np.zeros((10, 10, 3))], "float64"),
        ("sizes.mp4", odd, r"Frame 1 is of shape \(12, 10, 3\)"),
    ):
        with pytest.raises(ValueError, match=message):
            write_video(tmp_path / name, frames)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.mp4"]


@pytest.mark.parametrize("name", ["match.mp4", "match.gif"])
def test_a_full_disk_is_an_error_and_leaves_no_file(tmp_path, name):
    noise = np.random.default_rng(0).integers(0, 255, (40, 256, 256, 3), np.uint8)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # Writing beyond the limit fails, as on a full disk.
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(OSError, match="The video can't be written: ffmpeg ended with"):
            write_video(tmp_path / name, noise)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []
