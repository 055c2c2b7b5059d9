"""Damaged and crafted files for the loaders: real ones, changed at random but repeatably."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import random
import re
import signal
import zipfile
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import torch

SECONDS_PER_INPUT = 5.0

ODD_NUMBERS = (
    b"0", b"-1", b"NaN", b"nan", b"Infinity", b"-inf", b"1e999", b"null", b"true", b'""', b"[]",
    b"{}", b"1" * 5000, b"9007199254740993", b"0.1", b'"text"', b"[" * 3000, b'{"a":' * 3000,
)  # fmt: skip
ODD_VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 10**30, 10**400, 0.5, float("nan"), float("inf"), "", "text", "\ud800", [],
    {}, [1, 2], {"a": 1}, (), b"bytes", torch.zeros(3), torch.zeros(2, 2), torch.ones(3).bool(),
)  # fmt: skip


def changed_bytes(content: bytes, chance: random.Random) -> bytes:
    """Flips, sets, cuts, inserts, doubles and swaps bytes, and puts odd numbers for numbers."""
    changed = bytearray(content)
    for _ in range(chance.choice((1, 1, 1, 2, 4, 16))):
        at = chance.randrange(len(changed) + 1)
        to = min(len(changed), at + chance.choice((1, 2, 8, 64, 1024)))
        match chance.randrange(8):
            case 0 if at < len(changed):
                changed[at] ^= 1 << chance.randrange(8)
            case 1 if at < len(changed):
                changed[at] = chance.choice((0, 1, 0x7F, 0x80, 0xFF, 0x22, 0x0A, 0x2C))
            case 2:
                del changed[at:]
            case 3:
                del changed[at:to]
            case 4:
                changed[at:at] = chance.randbytes(chance.choice((1, 4, 64)))
            case 5:
                changed[at:at] = changed[at:to]
            case 6:
                other = chance.randrange(len(changed) + 1)
                changed[at:to], changed[other : other + to - at] = (
                    changed[other : other + to - at],
                    changed[at:to],
                )
            case 7:
                numbers = list(re.finditer(rb"-?\d+(\.\d+)?", changed))
                if numbers:
                    number = chance.choice(numbers)
                    changed[slice(*number.span())] = chance.choice(ODD_NUMBERS)
    return bytes(changed)


def changed_archive(content: bytes, chance: random.Random) -> bytes:
    """Changes bytes of a zip file, or of one of its members, whose checksum is then right."""
    if chance.random() < 0.4:
        return changed_bytes(content, chance)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = chance.choice(list(members))
    match chance.randrange(8):
        case 0:
            del members[name]
        case 1:
            members[name] = members[chance.choice(list(members))]
        case _:
            members[name] = changed_bytes(members[name], chance)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", chance.choice((0, zipfile.ZIP_DEFLATED))) as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return packed.getvalue()


def changed_gzip(content: bytes, chance: random.Random) -> bytes:
    """Changes bytes of a gzip file, or of what it holds."""
    if chance.random() < 0.3:
        return changed_bytes(content, chance)
    return gzip.compress(changed_bytes(gzip.decompress(content), chance), zlib.Z_BEST_SPEED)


def changed_json(content: bytes, chance: random.Random) -> bytes:
    """Changes bytes of a JSON file, or puts odd values for values."""
    if chance.random() < 0.4:
        return changed_bytes(content, chance)
    plain = [value for value in ODD_VALUES if not isinstance(value, (bytes, torch.Tensor))]
    return json.dumps(changed_tree(json.loads(content), chance, plain)).encode()


def changed_tree(
    tree: Any, chance: random.Random, values: list[Any] | tuple[Any, ...] = ODD_VALUES
) -> Any:
    """Lists and dictionaries with an entry left out, doubled, renamed or replaced, at any depth."""
    if isinstance(tree, (dict, list)) and tree and chance.random() < 0.9:
        changed = tree.copy()
        names = list(changed) if isinstance(changed, dict) else range(len(changed))
        name = chance.choice(list(names))
        match chance.randrange(10):
            case 0:
                del changed[name]
            case 1:
                changed[name] = changed[chance.choice(list(names))]
            case 2 if isinstance(changed, dict):
                changed[f"{name}s"] = changed.pop(name)
            case 3 | 4:
                changed[name] = chance.choice(values)
            case _:
                changed[name] = changed_tree(changed[name], chance, values)
        return changed
    return chance.choice(values)


@contextlib.contextmanager
def time_limit(seconds: float = SECONDS_PER_INPUT) -> Iterator[None]:
    """Raises ``TimeoutError`` in what takes longer: a loader that hangs."""

    def end(*_: object) -> None:
        raise TimeoutError(f"Nothing has come of it within {seconds:g} s.")

    before: Callable[..., Any] | int | None = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
