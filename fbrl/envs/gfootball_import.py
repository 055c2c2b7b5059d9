"""The engine and gfootball's scenarios, imported without gfootball's own environments.

The only module that imports them; the others get what they need of it from :func:`load_gfootball`.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import sys
import types
from dataclasses import dataclass

_INSTALL_REMEDY = (
    "Run `make setup` in a clone of fbrl, which builds it with everything that it needs; "
    "`fbrl-doctor` checks the result."
)


class EngineNotInstalledError(ImportError):
    """Raised where a match is asked for and the engine can't be imported."""


@dataclass(frozen=True)
class GFootball:
    """What is in use: our package of gfootball's engine, and two of gfootball's Python modules."""

    engine: types.ModuleType
    config: types.ModuleType
    action_set: types.ModuleType


def _import_bare(name: str) -> None:
    """Lets modules of a package be imported without what the package itself imports."""
    if name in sys.modules:
        return
    spec = importlib.util.find_spec(name)
    if spec is None or spec.submodule_search_locations is None:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    sys.modules[name] = importlib.util.module_from_spec(spec)


@functools.cache
def load_gfootball() -> GFootball:
    """Imports the engine, and of gfootball what builds scenarios: no gym, no OpenCV, no banner.

    Raises:
        EngineNotInstalledError: It, or something that it imports, is missing.
    """
    try:
        _import_bare("gfootball")
        _import_bare("gfootball.env")
        return GFootball(
            engine=importlib.import_module("fbrl_engine"),
            config=importlib.import_module("gfootball.env.config"),
            action_set=importlib.import_module("gfootball.env.football_action_set"),
        )
    except ImportError as error:
        raise EngineNotInstalledError(
            f"The football engine can't be imported ({error}). {_INSTALL_REMEDY}"
        ) from error
