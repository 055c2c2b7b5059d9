"""What the compiled engine needs of the system that it runs on."""

from __future__ import annotations

import platform
import re
from importlib.resources import files
from pathlib import Path

import pytest
from engines import engine_directory

# That of Debian 12, where wheels for other machines are made, and the oldest that they run with.
BUILT_WITH, OLDEST = 36, 34


@pytest.mark.skipif(
    platform.libc_ver() != ("glibc", f"2.{BUILT_WITH}"),
    reason="what is compiled with another glibc may need another one",
)
def test_it_needs_no_newer_glibc_than_the_pages_say() -> None:
    directory = engine_directory() or Path(str(files("fbrl_engine"))).parent
    (library,) = directory.glob("fbrl_engine/_native*.so")
    needed = re.findall(rb"\0GLIBC_2\.(\d+)(?=[.\0])", library.read_bytes())
    assert max(map(int, needed)) <= OLDEST
