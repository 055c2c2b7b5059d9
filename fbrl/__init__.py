"""fbrl: football agents under TorchRL, with a reward learned from real football.

Importing it registers the Gymnasium ids ``fbrl/<scenario>-v0``; nothing of the engine is
imported before an environment is made.
"""

from fbrl.registration import register_scenarios

__version__ = "0.1.0"

register_scenarios()
