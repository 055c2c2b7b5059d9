"""gfootball's own engine module, for its Python modules: the classes of :mod:`fbrl_engine`."""

from fbrl_engine import DATA, _native
from fbrl_engine._native import *  # noqa: F403


class GameEnv(_native.GameEnv):
    """One engine, as gfootball's own environment uses it; it does not render."""

    def __init__(self) -> None:
        super().__init__(str(DATA))
