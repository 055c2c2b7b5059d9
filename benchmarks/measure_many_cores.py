"""Collection on more cores than there are: an engine that sleeps leaves the real ones to the rest.

What a step would compute takes no core here, only its time. So as many threads as are asked for
behave as so many cores, except that what is left to do, Python, the network and waking the threads,
has to share the few real ones.
"""

from __future__ import annotations

import time
from typing import Any

from benchmarks.measure_vectorisation import frames_per_second

STEP_SECONDS, SPREAD = 0.002, 0.001
"""A step sleeps between 1 and 3 ms, as engines take."""

RESET_SECONDS, STEPS_PER_RESET = 0.0015, 100
"""One step in so many takes longer, by the time of a reset."""

GPU_SECONDS = 0.001
"""What a network on a GPU takes to answer, with transfers."""


def share_of_sleeping_engines(
    cores: int, network: str, matches_per_core: int, seconds: float, seed: int
) -> dict[str, float]:
    """Collects with the preset light's network, or one that sleeps as if it were on a GPU.

    Args:
        cores: Threads whose steps sleep.
        network: ``"mlp"`` or ``"gpu"``.
        matches_per_core: Matches, in units of ``cores``.
        seconds: How long to collect, after the first batch.
        seed: Of matches and network.

    Returns:
        ``frames_per_second``, and their ``share`` of what the threads could do asleep alone.
    """
    import torch

    from fbrl.collect import MatchCollector
    from fbrl.envs.engine import load_gfootball
    from fbrl.models.actor_critic import build_actor_critic

    torch.manual_seed(seed)
    policy = build_actor_critic("simple115").get_collection_policy()
    if network == "gpu":
        policy.trunk.register_forward_hook(lambda *_: time.sleep(GPU_SECONDS))
    collector = MatchCollector(
        "academy_3_vs_1_with_keeper",
        policy,
        num_envs=matches_per_core * cores,
        num_steps=64,
        num_threads=cores,
        seed=seed,
    )
    collector.reset()
    sleep: Any = load_gfootball().engine.Disturbance(
        "sleep",
        seconds=STEP_SECONDS,
        spread=SPREAD,
        reset_seconds=RESET_SECONDS,
        steps_per_reset=STEPS_PER_RESET,
    )
    collector.disturb(sleep)
    rate = frames_per_second(collector.collect, seconds)
    collector.close()
    bare = cores / (STEP_SECONDS + RESET_SECONDS / STEPS_PER_RESET)
    return {"frames_per_second": rate, "share": rate / bare}
