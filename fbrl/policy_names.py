"""Names of policies and of how they act, apart from modules whose import takes seconds."""

from __future__ import annotations

POLICIES = ("random", "idle", "builtin-ai")
"""The policies without a network, see :func:`fbrl.evaluation.policies.make_policy`."""

MODES = ("sample", "greedy")
"""How an agent chooses its actions: it samples them, or takes the most probable ones."""
