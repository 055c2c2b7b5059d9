"""The environment of a training, in the two parts that a collector in a hurry wants."""

from __future__ import annotations

from collections.abc import Callable

from torchrl.envs import Compose, ExcludeTransform, Transform, TransformedEnv

from fbrl.checks.names import check_name
from fbrl.collect.episode_bookkeeping import EpisodeBookkeeping
from fbrl.envs.episode_seeds import check_seed
from fbrl.envs.factory import as_torchrl, make_observation, make_reward, raw_keys_of
from fbrl.envs.process_vector_env import FootballProcessVectorEnv
from fbrl.envs.vector_env import FootballVectorEnv
from fbrl.transforms import PlayStatistics, ScoringReward

MATCH_PLACES = ("threads", "processes")
"""Where matches are played on one machine."""


def make_collection_env(
    scenario: str,
    *,
    num_envs: int = 8,
    reward: str | ScoringReward = "analytics",
    observation: str | Transform = "simple115",
    num_threads: int | None = None,
    collector: str = "threads",
    num_workers: int | None = None,
    worker_timeout: float = 20,
    on_restart: Callable[[str], None] = lambda line: None,
    seed: int | None = None,
) -> tuple[TransformedEnv, EpisodeBookkeeping]:
    """Makes what :func:`fbrl.envs.make_env` does in two parts, for a collector that is in a hurry.

    The environment computes what the policy needs. The bookkeeping writes the rest, the reward
    among it, into whole batches; both together give the same numbers.

    Args:
        scenario: As for :func:`~fbrl.envs.make_env`, like the next ones.
        num_envs: Number of matches.
        reward: Labels the batches.
        observation: What the policy reads.
        num_threads: Threads that step the matches.
        collector: ``"threads"`` plays the matches in this process, ``"processes"`` in others.
        num_workers: Number of these processes.
        worker_timeout: Seconds after which one that does not answer is replaced; 0 for never.
        on_restart: Called with one line about each replacement.
        seed: Seeds the matches.

    Raises:
        ValueError: A name is unknown.
        EngineNotInstalledError: gfootball is missing.
    """
    reward_transform = make_reward(reward)
    observation_transform = make_observation(observation)
    needed_later = raw_keys_of([reward_transform, PlayStatistics()])
    needed_now = raw_keys_of([observation_transform])
    if seed is not None:
        check_seed(seed)
    keys = needed_now | needed_later
    matches: FootballVectorEnv | FootballProcessVectorEnv
    if check_name("collector", collector, MATCH_PLACES) == "processes":
        matches = FootballProcessVectorEnv(
            scenario,
            num_envs,
            num_threads,
            keys,
            num_workers=num_workers,
            timeout=worker_timeout,
            on_restart=on_restart,
        )
    else:
        matches = FootballVectorEnv(scenario, num_envs, num_threads, keys)
    env = TransformedEnv(
        as_torchrl(matches),
        Compose(observation_transform, ExcludeTransform(*sorted(needed_now - needed_later))),
    )
    if seed is not None:
        env.set_seed(seed)
    return env, EpisodeBookkeeping(reward_transform, drop=sorted(needed_later))
