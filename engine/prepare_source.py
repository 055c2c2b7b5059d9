"""Puts the engine's source into a directory: gfootball's as PyPI has it, with our patches.

``python prepare_source.py TARGET`` is what the build calls. With ``--git`` the target becomes a git
repository with a commit for each patch, to work on them in: change or add commits there, and
``--export`` writes them back, each as a patch without context lines under its message.

The environment variable ``GFOOTBALL_SDIST`` names a downloaded gfootball-2.10.2.tar.gz to take
instead of asking pip, for machines without a network.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import whatthepatch

VERSION = "2.10.2"
SHA256 = "1b0fdcfa78b7fadc3730585ee7f0f412ba825c27e422b2b85ea0cf7ba57800b6"
SDIST = f"gfootball-{VERSION}.tar.gz"
PATCHES = Path(__file__).resolve().parent / "patches"


def download(folder: Path) -> Path:
    """Has pip fetch the source distribution, from the index that it is configured for."""
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "download", "--no-deps"]
    command += ["--no-build-isolation", "--no-binary", ":all:", "--dest", str(folder)]
    result = subprocess.run([*command, f"gfootball=={VERSION}"], capture_output=True, text=True)
    if result.returncode:
        sys.exit(
            f"error: pip could not fetch gfootball {VERSION}:\n{result.stderr[-2000:]}\n"
            f"Without a network, set GFOOTBALL_SDIST to a downloaded {SDIST}."
        )
    return folder / SDIST


def unpack(sdist: Path, target: Path) -> None:
    """Unpacks a source distribution whose content is the one that the patches are for."""
    if not sdist.is_file():
        sys.exit(f"error: {sdist}: no such file. GFOOTBALL_SDIST has to name a {SDIST}.")
    digest = hashlib.sha256(sdist.read_bytes()).hexdigest()
    if digest != SHA256:
        sys.exit(f"error: {sdist} has the sha256 {digest}, not {SHA256} as on PyPI.")
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        with tarfile.open(sdist) as archive:
            # Debian 12's Python has no filters yet, later ones warn where none is chosen.
            archive.extraction_filter = getattr(tarfile, "data_filter", None)
            archive.extractall(folder)
        shutil.rmtree(target, ignore_errors=True)
        Path(folder, f"gfootball-{VERSION}").rename(target)


def apply(patch: Path, target: Path) -> None:
    """Applies a patch, whose lines have to be found exactly where it says."""
    for diff in whatthepatch.parse_patch(patch.read_text(encoding="utf-8")):
        name = diff.header.new_path if diff.header.new_path != "/dev/null" else diff.header.old_path
        path = target / re.sub("^[ab]/", "", name)
        is_new = diff.header.old_path == "/dev/null"
        old = [] if is_new else path.read_text(encoding="utf-8").split("\n")
        new = whatthepatch.apply_diff(diff, old)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(new) + ("\n" if is_new else ""), encoding="utf-8")


def git(target: Path, *arguments: str) -> str:
    """What a git command says, run in the target."""
    identity = ["-c", "user.name=fbrl", "-c", "user.email=fbrl@localhost"]
    command = ["git", *identity, *arguments]
    return subprocess.run(command, cwd=target, check=True, capture_output=True, text=True).stdout


def message_of(patch: Path) -> str:
    """What stands above a patch's changes."""
    return patch.read_text(encoding="utf-8").partition("\ndiff --git ")[0].strip()


def export(target: Path) -> None:
    """Writes the commits on top of gfootball's as patches."""
    for patch in PATCHES.glob("*.patch"):
        patch.unlink()
    _upstream, *commits = git(target, "rev-list", "--reverse", "HEAD").split()
    for number, commit in enumerate(commits, 1):
        message = git(target, "show", "--no-patch", "--format=%B", commit).strip()
        title = re.sub(r"[^a-z0-9]+", "-", message.partition("\n")[0].lower()).strip("-")
        diff = git(target, "show", "--format=", "--unified=0", "--no-renames", commit)
        path = PATCHES / f"{number:02d}-{title}.patch"
        path.write_text(f"{message}\n\n{diff}", encoding="utf-8")


def main() -> None:
    """Prepares the target, or exports from it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("target", type=Path)
    parser.add_argument("--git", action="store_true", help="a repository with a commit a patch")
    parser.add_argument("--export", action="store_true", help="write its commits to patches/")
    arguments = parser.parse_args()
    target = arguments.target.resolve()
    if arguments.export:
        export(target)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        named = os.environ.get("GFOOTBALL_SDIST")
        unpack(Path(named) if named else download(Path(folder)), target)
    if arguments.git:
        git(target, "init", "--quiet")
        git(target, "add", "--all")
        git(target, "commit", "--quiet", "--message", f"gfootball {VERSION}")
    for patch in sorted(PATCHES.glob("*.patch")):
        apply(patch, target)
        if arguments.git:
            git(target, "add", "--all")
            git(target, "commit", "--quiet", "--message", message_of(patch))


if __name__ == "__main__":
    main()
