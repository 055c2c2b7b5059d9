"""The commands' parsers, and how they end: bad usage or input, signals, hangs, broken output."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import IO, Any, NoReturn, cast

BAD_USAGE = 2

FAILED = 1
"""Exit code where what was asked for could not be done, for no fault of the input's."""

INTERRUPTED = 130
"""Exit code of a command that a signal ended, as shells give it."""

SECONDS_TO_TIDY_UP = 15.0
"""A match that hangs is waited for twice, five seconds each, before its error is passed on."""


def fail(program: str, message: object, exit_code: int = BAD_USAGE) -> NoReturn:
    """Prints one line on stderr and exits, with code 2 unless another one is given."""
    line = " ".join(str(message).split())
    print(f"{program}: error: {line}", file=sys.stderr)
    sys.exit(exit_code)


class _HelpFormatter(argparse.RawDescriptionHelpFormatter, argparse.ArgumentDefaultsHelpFormatter):
    def _get_help_string(self, action: argparse.Action) -> str | None:
        has_none = isinstance(action.default, bool) or action.default in (None, "", [])
        if has_none or "default:" in (action.help or ""):
            return action.help
        return super()._get_help_string(action)


class Parser(argparse.ArgumentParser):
    """Answers bad usage with one line, where argparse prints the usage too.

    Descriptions are printed as they are written, each help ends with the default, if there is one
    and it doesn't say so itself, and options have to be spelt out.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=_HelpFormatter, allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        """Prints the line and exits with code 2."""
        fail(self.prog, f"{message} (see {self.prog} --help)")


def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], None] | None,
    summary: str,
    description: str | None = None,
) -> Parser:
    """Adds a subcommand that calls ``run``."""
    description = description or f"{summary[0].upper()}{summary[1:]}."
    parser = commands.add_parser(name, help=summary, description=description)
    parser.set_defaults(command=run, program=parser.prog)
    return parser


def run_command(options: argparse.Namespace, remark: str) -> NoReturn:
    """Runs the subcommand that was chosen and ends the process."""
    with ending_when_interrupted(options.program, remark), ending_on_bad_input(options.program):
        options.command(options)
    sys.exit(0)


@contextlib.contextmanager
def ending_on_bad_input(program: str) -> Iterator[None]:
    """Answers what bad input raises, and what is not installed, with one line and exit code 2."""
    try:
        yield
    except (ValueError, OSError, ImportError) as error:
        fail(program, error)


@contextlib.contextmanager
def ending_when_interrupted(program: str, remark: str = "interrupted") -> Iterator[None]:
    """Answers SIGINT and SIGTERM with one line on stderr and exit code 130.

    Prints that can't be written end nothing, so that a command's files are written in any case.
    Its exit code is 1 then; of a reader that has gone, such as ``head``, nothing is said.
    """

    def tell() -> None:
        print(f"{program}: {remark}", file=sys.stderr, flush=True)

    with _outlasting_broken_output() as output:
        try:
            with _raising_keyboard_interrupt(tell):
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
def _raising_keyboard_interrupt(on_no_end: Callable[[], None]) -> Iterator[None]:
    """Turns SIGINT and SIGTERM into ``KeyboardInterrupt``, and ends the process if it doesn't.

    Signals that were ignored on purpose stay so. Outside the main thread nothing is changed.
    ``on_no_end`` is called in a thread of its own just before the process is ended,
    :data:`SECONDS_TO_TIDY_UP` after a signal.
    """

    def end() -> None:
        try:
            on_no_end()
        finally:
            # Nothing else ends a process whose main thread is in the engine.
            os._exit(INTERRUPTED)

    timer = threading.Timer(SECONDS_TO_TIDY_UP, end)
    timer.daemon = True

    def handle(number: int, frame: Any) -> None:
        # A second signal breaks off the tidying up, but not its time limit.
        if timer.ident is None:
            timer.start()
        raise KeyboardInterrupt

    previous = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:
                previous[number] = signal.signal(number, handle)
    try:
        yield
    finally:
        timer.cancel()
        for number, handler in previous.items():
            signal.signal(number, handler)


class _UnbreakableStream:
    """A stream whose text is lost, without an error, where it can't be written.

    Letters that its encoding lacks are written as escapes. ``error`` is the first one that there
    was.
    """

    def __init__(self, stream: IO[str] | None) -> None:
        # There is none in a process that was started with it closed. What takes its number is then
        # nothing that the engine could write to.
        self._stream = stream or open(os.devnull, "w")  # noqa: SIM115
        self.error: OSError | None = None

    def write(self, text: str) -> int:
        encoding = getattr(self._stream, "encoding", None) or "utf-8"
        with self._noting_errors():
            self._stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        return len(text)

    def flush(self) -> None:
        with self._noting_errors():
            self._stream.flush()

    def finish(self) -> None:
        """Writes what waits, and lets go of what can't be written."""
        self.flush()
        if self.error is not None:
            # Python would try again at the end of the process, and complain. Not every stream has
            # a descriptor: a notebook's hasn't.
            with open(os.devnull, "w") as nowhere, contextlib.suppress(OSError):
                os.dup2(nowhere.fileno(), self._stream.fileno())

    @contextlib.contextmanager
    def _noting_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.error = self.error or error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def _outlasting_broken_output() -> Iterator[_UnbreakableStream]:
    """Yields standard output; it, and standard error, are lost where they can't be written."""
    streams = sys.stdout, sys.stderr
    output, errors = map(_UnbreakableStream, streams)
    sys.stdout, sys.stderr = cast("IO[str]", output), cast("IO[str]", errors)
    try:
        yield output
    finally:
        sys.stdout, sys.stderr = streams
        output.finish()
        errors.finish()


@contextlib.contextmanager
def playing(program: str) -> Iterator[None]:
    """Ends a command, with one line on stderr and exit code 1, where a match hangs.

    It must be within :func:`ending_when_interrupted`.

    Raises:
        EngineNotInstalledError: gfootball is missing.
    """
    from fbrl.collect.watchdog import Watchdog
    from fbrl.config import TrainConfig
    from fbrl.envs.engine import load_gfootball

    load_gfootball()
    hanging: list[str] = []

    def end(matches: Sequence[str]) -> None:
        hanging.extend(matches)
        # What is being written is tidied up, as after Ctrl-C.
        signal.raise_signal(signal.SIGINT)

    limit: float = TrainConfig.hang_timeout
    try:
        with Watchdog(limit, end):
            yield
    except KeyboardInterrupt:
        if not hanging:
            raise
        took = f"took more than {limit:g} s"
        fail(program, f"The engine hangs: {', '.join(hanging)} {took}. Try another seed.", FAILED)


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
