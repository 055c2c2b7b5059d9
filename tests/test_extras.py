"""Packages that are not installed."""

from __future__ import annotations

import sys

import pytest

from fbrl.checks import MissingExtraError, missing_packages
from fbrl.watch.video import check_video_packages, missing_video_packages


def test_the_error_names_packages_and_extra_and_is_an_import_error():
    error = MissingExtraError("Videos", ["cv2", "mplsoccer"], "analysis")
    assert isinstance(error, ImportError)
    assert str(error) == (
        "Videos need cv2 and mplsoccer, not installed here: `pip install 'fbrl[analysis]'`."
    )


def test_those_that_are_missing_are_found_without_importing_any():
    assert missing_packages(["torch", "no_such_package"]) == ["no_such_package"]
    assert "antigravity" not in sys.modules
    assert missing_packages(["antigravity"]) == []
    assert "antigravity" not in sys.modules


def test_what_videos_lack_is_listed_once_for_all_who_make_them(monkeypatch):
    for name in ("mplsoccer", "imageio_ffmpeg", "cv2"):
        pytest.importorskip(name)
    assert missing_video_packages() == []
    monkeypatch.setitem(sys.modules, "mplsoccer", None)  # as if it were not installed
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert missing_video_packages() == ["mplsoccer", "cv2"]
    with pytest.raises(MissingExtraError, match="Videos need mplsoccer and cv2"):
        check_video_packages()
