"""fbrl: football agents under TorchRL, with a reward learned from real football.

Importing it registers the Gymnasium ids ``fbrl/<scenario>-v0``; nothing of the engine is
imported before an environment is made.
"""

from typing import TYPE_CHECKING, Any

from fbrl.scenarios import register_scenarios

if TYPE_CHECKING:
    from fbrl.agent import load_agent

__all__ = ["load_agent"]

__version__ = "0.1.0"

register_scenarios()


def __getattr__(name: str) -> Any:
    # PyTorch takes seconds to import, which an environment need not wait for.
    if name == "load_agent":
        from fbrl.agent import load_agent

        return load_agent
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
