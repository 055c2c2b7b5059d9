"""How the commands end on bad usage or bad input: one line on stderr and exit code 2."""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Iterator
from typing import NoReturn

BAD_USAGE = 2


def fail(program: str, message: object) -> NoReturn:
    """Prints one line on stderr and exits with code 2."""
    line = " ".join(str(message).split())
    print(f"{program}: error: {line}", file=sys.stderr)
    sys.exit(BAD_USAGE)


@contextlib.contextmanager
def parsing(program: str) -> Iterator[None]:
    """Turns the framed, many-lined errors of tyro's parser into one line that says the same."""
    captured = io.StringIO()
    try:
        with contextlib.redirect_stderr(captured):
            yield
    except SystemExit as end:
        if not end.code:
            raise
        message = re.sub(r"\x1b\[[0-9;]*m|[\u2500-\u257f]", " ", captured.getvalue())
        message, _, _ = message.partition("For full helptext")
        message = " ".join(message.split()).removeprefix("Parsing error").strip()
        fail(program, f"{message} (see {program} --help)")
