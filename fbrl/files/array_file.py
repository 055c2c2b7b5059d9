"""Arrays from ``.npz`` files that may be damaged, or come from a stranger."""

from __future__ import annotations

import warnings
import zipfile
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray


class ArrayFileError(ValueError):
    """Raised for a file that holds no arrays, is damaged, or would fill the memory."""


def read_arrays(file: IO[bytes], largest: int) -> dict[str, NDArray[Any]]:
    """Reads all arrays of a ``.npz`` file. Runs no code from the file: pickles are refused.

    One whose arrays have more than ``largest`` bytes is refused before it is unpacked: a few
    kilobytes of zeros unpack to gigabytes.

    Raises:
        ArrayFileError: It can't be read, is no such file, is damaged, or is larger.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > largest:
            raise ArrayFileError(f"it unpacks to {size:,} bytes, more than {largest:,}")
        file.seek(0)
        with np.load(file, allow_pickle=False) as members, warnings.catch_warnings():
            # Of what a damaged member seems to be.
            warnings.simplefilter("ignore")
            arrays = {name: members[name] for name in members.files}
        for name, array in arrays.items():
            # A member that does not begin as an array does is handed out as bytes.
            if not isinstance(array, np.ndarray):
                raise ArrayFileError(f"{name} is no array")
        return arrays
    except ArrayFileError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise a dozen kinds for damaged files
        raise ArrayFileError(f"{type(error).__name__}: {error}") from error
