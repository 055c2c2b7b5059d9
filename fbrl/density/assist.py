"""The pair of densities behind the assist reward, and the file that holds them."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import IO, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from fbrl.checks import FieldTypeError, check_field_types
from fbrl.density.position import PositionDensity
from fbrl.files.array_file import ArrayFileError, read_arrays
from fbrl.files.atomic_write import atomic_write

FORMAT = "fbrl-assist-density"
FORMAT_VERSION = 1
_LARGEST_CONTENT = 64 * 2**20
DEFAULT_FILE = "open_play_assists_2015_16.npz"
_REFIT = "Fit a new one with `fbrl-density fit`."


class _NewerFormatError(ValueError):
    """Raised for a file that is whole, but of a later fbrl."""


@dataclasses.dataclass(frozen=True)
class DensityMetadata:
    """Where a pair of densities comes from.

    Attributes:
        source: the competitions and seasons.
        filter: which passes were taken.
        n: how many passes.
        bandwidth_rule: the rule or number that the kernel came from.
        bandwidth_start: the start kernel's isotropic bandwidth in pitch units; for one with a full
            covariance, the isotropic bandwidth of the same area.
        bandwidth_end: the same for the end kernel.
        max_interpolation_error: the largest difference between the grids and the exact kernel sum,
            as a fraction of the peak.
        credit: the credit that the data's owner asks for.
        counts: how many passes there are of each competition and season.
        metres: whether an isotropic kernel is round in metres instead of in pitch units.
        mirror: whether the surfaces were averaged with their left-right mirror images.

    Raises:
        TypeError: if a value is of another kind.
    """

    source: str
    filter: str
    n: int
    bandwidth_rule: str
    bandwidth_start: float
    bandwidth_end: float
    max_interpolation_error: float
    credit: str
    counts: Mapping[str, int] = dataclasses.field(default_factory=dict)
    metres: bool = False
    mirror: bool = False

    def __post_init__(self) -> None:
        """Checks the kinds, as another one could be saved but not be read again."""
        check_field_types(self)
        for group, n in self.counts.items():
            if not (isinstance(group, str) and isinstance(n, int)):
                raise FieldTypeError(f"counts is {self.counts!r}; it must give integers for texts.")


_FIELDS = [field.name for field in dataclasses.fields(DensityMetadata)]
_LATER_FIELDS = ("counts", "metres", "mirror")
"""Those that files of fbrl 0.1 lack."""


class AssistDensity(nn.Module):
    """Where goal-assisting passes start and end.

    Args:
        start: density of the positions that assists were played from.
        end: density of the positions that assists were received at.
        metadata: where they come from; ``None`` for made-up densities, which cannot be saved.

    Raises:
        TypeError: if one of them is something else.

    Examples:
        >>> from fbrl.density import AssistDensity
        >>> density = AssistDensity.default()
        >>> density.start.peak, density.end.peak
        (0.001, 0.1)
        >>> density.metadata.n, density.metadata.credit
        (474, 'Data: StatsBomb')
        >>> import torch
        >>> ball = torch.tensor([[0.75, 0.0], [-0.75, 0.0]])  # in front of either goal
        >>> density.end(ball).round(decimals=4)
        tensor([0.0544, 0.0000])
    """

    def __init__(
        self,
        start: PositionDensity,
        end: PositionDensity,
        metadata: DensityMetadata | None = None,
    ) -> None:
        super().__init__()
        for name, surface in (("start", start), ("end", end)):
            if not isinstance(surface, PositionDensity):
                raise TypeError(
                    f"{name} is a {type(surface).__name__}; expected a PositionDensity."
                )
        if not isinstance(metadata, DensityMetadata | None):
            raise TypeError(
                f"metadata is a {type(metadata).__name__}; expected DensityMetadata or None."
            )
        self.start = start
        self.end = end
        self.metadata = metadata

    @classmethod
    def default(cls) -> AssistDensity:
        """Load the densities that fbrl ships: 474 open-play assists of 2015/16.

        Fitted to the Premier League and Ligue 1. Data: StatsBomb.
        """
        shipped = resources.files("fbrl.density").joinpath(DEFAULT_FILE)
        with shipped.open("rb") as file:
            return _read(file, DEFAULT_FILE)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> AssistDensity:
        """Load densities from a file written by :meth:`save`. Runs no code from the file.

        Raises:
            OSError: if there is no such file, or it cannot be read.
            TypeError: if the path is none.
            ValueError: if the file is truncated, of another format, of a newer version, or holds
                grids that are not densities.
        """
        if not isinstance(path, (str, os.PathLike)):
            raise TypeError(f"path is {path!r}; expected the path of a density file.")
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"No density file at {path}. {_REFIT}")
        with path.open("rb") as file:
            return _read(file, str(path))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all to one file (a ``.npz`` without pickle), in one piece or not at all.

        Raises:
            ValueError: if there is no metadata.
            OSError: if the file cannot be written.
        """
        if self.metadata is None:
            raise ValueError(
                "This AssistDensity has no metadata. Make it with metadata=DensityMetadata(...), "
                "so that the file says where its numbers come from."
            )
        header = {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "peak_start": self.start.peak,
            "peak_end": self.end.peak,
            **dataclasses.asdict(self.metadata),
        }
        # Through a file object: numpy would append ".npz" to a path without it.
        with atomic_write(Path(path)) as file:
            np.savez_compressed(
                file,
                metadata=np.array(json.dumps(header, ensure_ascii=False)),
                start=self.start.grid.cpu().numpy(),
                end=self.end.grid.cpu().numpy(),
            )


def _read(file: IO[bytes], name: str) -> AssistDensity:
    try:
        return _density_of(read_arrays(file, _LARGEST_CONTENT))
    except ArrayFileError as error:
        raise ValueError(
            f"{name} is not a readable density file ({error}): truncated, or another format. "
            f"{_REFIT}"
        ) from error
    except _NewerFormatError as error:
        raise ValueError(f"{name}: {error}") from error
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name}: {error} {_REFIT}") from error


def _density_of(entries: Mapping[str, NDArray[Any]]) -> AssistDensity:
    missing = {"metadata", "start", "end"} - entries.keys()
    if missing:
        raise ValueError(f"the file lacks the entries {sorted(missing)}.")
    try:
        header = json.loads(str(entries["metadata"]))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"its metadata is not JSON ({error}).") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ValueError(f"its metadata does not say format {FORMAT!r}.")
    version = header.get("version")
    if not isinstance(version, int) or version > FORMAT_VERSION:
        raise _NewerFormatError(
            f"it has format version {version!r}; this fbrl reads up to {FORMAT_VERSION}. Upgrade "
            "fbrl (`pip install -U fbrl`)."
        )
    missing = {*_FIELDS, "peak_start", "peak_end"} - {*_LATER_FIELDS, *header}
    if missing:
        raise ValueError(f"its metadata lacks {sorted(missing)}.")

    def surface(side: str) -> PositionDensity:
        grid = entries[side]
        if grid.dtype.kind != "f":
            raise ValueError(f"{side}: its grid has dtype {grid.dtype}, not floating point.")
        values = torch.from_numpy(np.ascontiguousarray(grid, np.float32))
        try:
            return PositionDensity(values, header[f"peak_{side}"])
        except (ValueError, TypeError) as error:
            raise ValueError(f"{side}: {error}") from error

    try:
        metadata = DensityMetadata(**{name: header[name] for name in _FIELDS if name in header})
    except TypeError as error:
        raise ValueError(f"in its metadata {error}") from error
    return AssistDensity(surface("start"), surface("end"), metadata)
