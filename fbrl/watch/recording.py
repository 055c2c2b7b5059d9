"""Matches recorded step by step: all that is needed to draw them, or to play them once more."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torchrl.envs import EnvBase, ExplorationType, Transform, set_exploration_type, step_mdp

from fbrl.envs.factory import make_env, make_reward
from fbrl.envs.rendering import DRAWN_KEYS
from fbrl.evaluation.evaluation import Policy
from fbrl.scenarios import SECONDS_PER_FRAME
from fbrl.transforms import ScoringReward

RECORDED_KEYS = (*DRAWN_KEYS, "ball_owned_team", "ball_owned_player", "sticky_actions")
"""What is kept of every observation; :mod:`fbrl.envs.observation` says what it means."""


@dataclass(frozen=True, eq=False)
class MatchRecording:
    """One match of n steps, and so of n + 1 states.

    The engine plays the same match again for the same scenario, seed, episode number, actions and
    frame skip, so that no state of the engine need be kept to show the match in three dimensions.

    Attributes:
        scenario: A name in :data:`fbrl.envs.SCENARIOS`.
        engine_seed: Seed of the episode.
        episode_number: Its number, which decides who kicks off.
        actions: int64 (n,) in [0, 19]: action i led from state i to state i + 1.
        observations: For each of :data:`RECORDED_KEYS` an array (n + 1, ...), ended by its shape.
        rewards: For each part of the reward, by its name in the environment, float32 (n,).
        frame_skip: Steps of gfootball in each step.
    """

    scenario: str
    engine_seed: int
    episode_number: int
    actions: np.ndarray
    observations: Mapping[str, np.ndarray]
    rewards: Mapping[str, np.ndarray]
    frame_skip: int = 1

    @property
    def num_steps(self) -> int:
        """Steps that the match took."""
        return len(self.actions)

    @property
    def seconds_per_step(self) -> float:
        """How long a step lasts, where the game is not interrupted."""
        return SECONDS_PER_FRAME * self.frame_skip

    @property
    def score(self) -> tuple[int, int]:
        """Goals of the left, trained, team and of the right one at the end."""
        left, right = self.observations["score"][-1].tolist()
        return left, right


def record_matches(
    policy: Policy,
    scenario: str,
    *,
    observation: str | Transform,
    reward: str | ScoringReward,
    episodes: int,
    seed: int,
    frame_skip: int = 1,
    greedy: bool = False,
    device: torch.device | str = "cpu",
    on_progress: Callable[[int, int], None] | None = None,
) -> Iterator[MatchRecording]:
    """Plays matches, one after the other, and yields each when it is over.

    The same seed gives the same matches. Torch's random numbers are left as they were, so that
    matches may be recorded in the middle of a training.

    Args:
        policy: Reads the observation and writes ``action``; an agent's, or one of
            :func:`fbrl.evaluation.policies.make_policy`, whose ``action_set`` is heeded.
        scenario: A name in :data:`fbrl.envs.SCENARIOS`.
        observation: Of the policy, as for :func:`fbrl.envs.make_env`.
        reward: Whose parts are recorded, likewise.
        episodes: How many matches.
        seed: Of the matches and of the sampled actions.
        frame_skip: Of the matches, likewise.
        greedy: Take the most probable action instead of sampling.
        device: Where the policy runs.
        on_progress: Called after each step with the matches that are over and the steps of the
            one that is played.

    Raises:
        UnknownNameError: There is no such scenario, observation or reward.
        EngineNotInstalledError: gfootball is missing.

    Examples:
        >>> def shoot(state):
        ...     return state.set("action", torch.full(state.batch_size, 12))
        >>> matches = record_matches(
        ...     shoot, "academy_empty_goal_close", observation="simple115", reward="scoring",
        ...     episodes=1, seed=0,
        ... )
        >>> [match.score for match in matches]
        [(1, 0)]
    """
    reward = make_reward(reward)
    env = make_env(
        scenario,
        num_envs=1,
        num_threads=1,
        reward=reward,
        observation=observation,
        action_set=getattr(policy, "action_set", "default"),
        frame_skip=frame_skip,
        keep_keys=RECORDED_KEYS,
        seed=seed,
    )
    device = torch.device(device)
    sampling_seeds = np.random.SeedSequence(seed).generate_state(episodes)
    exploration = ExplorationType.DETERMINISTIC if greedy else ExplorationType.RANDOM
    with contextlib.closing(env):
        for index in range(episodes):

            def progress(steps: int, finished: int = index) -> None:
                if on_progress is not None:
                    on_progress(finished, steps)

            with (
                torch.no_grad(),
                torch.random.fork_rng(devices=[device] if device.type == "cuda" else []),
                set_exploration_type(exploration),
            ):
                torch.manual_seed(int(sampling_seeds[index]))
                match = _record_match(env, policy, scenario, reward.part_names, device, progress)
            yield match


def _record_match(
    env: EnvBase,
    policy: Policy,
    scenario: str,
    parts: tuple[str, ...],
    device: torch.device,
    on_progress: Callable[[int], None],
) -> MatchRecording:
    state = env.reset()
    ((engine_seed, episode_number),) = env.episodes
    observations = [state.select(*RECORDED_KEYS)]
    actions, rewards = [], []
    done = False
    while not done:
        step = env.step(policy(state.to(device)).to("cpu"))
        state = step_mdp(step)
        actions.append(step["action"].item())
        observations.append(state.select(*RECORDED_KEYS))
        rewards.append([step["next", part].item() for part in parts])
        done = bool(step["next", "done"].item())
        on_progress(len(actions))
    return MatchRecording(
        scenario,
        engine_seed,
        episode_number,
        np.array(actions, np.int64),
        # The batch of one match becomes the sequence of its states.
        {key: torch.cat([o[key] for o in observations]).numpy() for key in RECORDED_KEYS},
        dict(zip(parts, np.array(rewards, np.float32).T, strict=True)),
        env.matches.frame_skip,
    )
