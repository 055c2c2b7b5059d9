"""Google Research Football's engine: matches stepped by C++ threads, bit for bit gfootball's.

:class:`Matches` plays many of them. The classes of gfootball's own engine are here as well, under
their names, and the module ``gfootball_engine`` hands them to gfootball's Python modules.
"""

from __future__ import annotations

from pathlib import Path

from fbrl_engine import _native

DATA = Path(__file__).parent / "data"
"""What matches are played with: animations and the shapes of bodies."""
