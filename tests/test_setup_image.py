"""The Dockerfile's image gets a clean clone, whatever lies in the one it is built from."""

from __future__ import annotations

from pathlib import Path

REPOSITORY = Path(__file__).parent.parent


def patterns(name: str) -> set[str]:
    lines = (REPOSITORY / name).read_text().splitlines()
    return {line for line in lines if line and not line.startswith("#")}


def test_what_git_ignores_is_not_copied_into_the_image() -> None:
    ignored = patterns(".gitignore")
    assert "runs/" in ignored
    # Git's patterns hold in every folder, Docker's only where they say so.
    assert {f"**/{pattern.rstrip('/')}" for pattern in ignored} <= patterns(".dockerignore")


def test_the_history_is_not_copied_into_the_image() -> None:
    assert ".git" in patterns(".dockerignore")
