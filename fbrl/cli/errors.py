"""How the commands end on bad usage, bad input or an interruption: one line on stderr."""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
from collections.abc import Iterator
from typing import Any, NoReturn

from fbrl.cli.lasting_output import lasting_streams
from fbrl.cli.signals import raising_keyboard_interrupt

BAD_USAGE = 2

FAILED = 1
"""Exit code where what was asked for could not be done, for no fault of the input's."""

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
    """Answers SIGINT and SIGTERM with one line on stderr and exit code 130.

    Prints that can't be written end nothing, so that a command's files are written in any case.
    Its exit code is 1 then; of a reader that has gone, such as ``head``, nothing is said.
    """

    def tell() -> None:
        print(f"{program}: {remark}", file=sys.stderr, flush=True)

    with lasting_streams() as output:
        try:
            with raising_keyboard_interrupt(tell, INTERRUPTED):
                yield
        except KeyboardInterrupt:
            tell()
            sys.exit(INTERRUPTED)
        output.flush()
        if isinstance(output.error, BrokenPipeError):
            sys.exit(FAILED)
        if output.error is not None:
            fail(program, f"standard output can't be written ({output.error.strerror}).", FAILED)


@contextlib.contextmanager
def ending_on_bad_input(program: str) -> Iterator[None]:
    """Answers what bad input raises, and what is not installed, with one line and exit code 2."""
    try:
        yield
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
