"""fbrl: football agents under TorchRL, with a reward learned from real football.

Importing it registers the Gymnasium ids ``fbrl/<scenario>-v0``; nothing of the engine is
imported before an environment is made.
"""

import gymnasium

from fbrl.scenarios import SCENARIOS

__version__ = "0.1.0"

for _name in SCENARIOS:
    gymnasium.register(
        id=f"fbrl/{_name}-v0",
        entry_point="fbrl.envs.football:FootballEnv",
        vector_entry_point="fbrl.envs.vector_env:FootballVectorEnv",
        kwargs={"scenario": _name},
    )
