"""Packages that only some of fbrl needs, and that are installed as an extra."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence


class MissingExtraError(ImportError):
    """Raised where what is asked for needs packages of an extra that are not installed."""

    def __init__(self, what: str, packages: Sequence[str], extra: str) -> None:
        super().__init__(
            f"{what} need {' and '.join(packages)}, not installed here: "
            f"`pip install 'fbrl[{extra}]'`."
        )


def missing_packages(packages: Sequence[str]) -> list[str]:
    """Those of some packages, by the names that they are imported by, that are not installed."""
    return [name for name in packages if importlib.util.find_spec(name) is None]
