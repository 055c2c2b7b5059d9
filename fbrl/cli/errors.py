"""How the commands end on bad usage, bad input or an interruption: one line on stderr."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import sys
from collections.abc import Iterator
from typing import Any, NoReturn

BAD_USAGE = 2

INTERRUPTED = 130
"""Exit code of a command that a signal ended, as shells give it."""


def fail(program: str, message: object, exit_code: int = BAD_USAGE) -> NoReturn:
    """Prints one line on stderr and exits, with code 2 unless another one is given."""
    line = " ".join(str(message).split())
    print(f"{program}: error: {line}", file=sys.stderr)
    sys.exit(exit_code)


class Parser(argparse.ArgumentParser):
    """Answers bad usage with one line, where argparse prints the usage too.

    Descriptions are printed as they are written, and options have to be spelt out.
    """

    def __init__(self, **options: Any) -> None:
        raw = argparse.RawDescriptionHelpFormatter
        super().__init__(formatter_class=raw, allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        """Prints the line and exits with code 2."""
        fail(self.prog, f"{message} (see {self.prog} --help)")


@contextlib.contextmanager
def ending_when_interrupted(program: str, remark: str = "interrupted") -> Iterator[None]:
    """Answers an interruption with one line on stderr and exit code 130.

    A reader of the output that has gone, such as ``head``, ends the program without a word.
    """
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # Python flushes standard output once more when it ends, and would complain then.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except KeyboardInterrupt:
        print(f"{program}: {remark}", file=sys.stderr)
        sys.exit(INTERRUPTED)


@contextlib.contextmanager
def ending_on_bad_input(program: str) -> Iterator[None]:
    """Answers what bad input raises, and what is not installed, with one line and exit code 2."""
    try:
        yield
    except BrokenPipeError:  # of the output, see above
        raise
    except (ValueError, OSError, ImportError) as error:
        fail(program, error)


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
        text = re.sub(r"\x1b\[[0-9;]*m", "", captured.getvalue())
        # The frame's first line holds a title only; what follows these words repeats the help.
        inside = re.sub(r"^\u256d.*$|[\u2500-\u257f]", " ", text, flags=re.MULTILINE)
        message = re.split(r"For full helptext|Argument helptext:", inside)[0]
        fail(program, f"{' '.join(message.split())} (see {program} --help)")
