"""Agents and baselines that play the same evaluation, and what their results say together."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from fbrl.agent import load_agent
from fbrl.analysis.run_groups import RunGroup, group_runs
from fbrl.analysis.run_log import (
    GOAL_DIFFERENCE,
    RunLog,
    frames_until,
    paper_goal_difference,
    read_run_log,
)
from fbrl.analysis.seed_statistics import Estimate, interquartile_mean, probability_of_improvement
from fbrl.assembly import make_agent_observation, make_training_reward
from fbrl.config import TrainConfig
from fbrl.envs import make_env
from fbrl.envs.factory import EPISODE_PREFIX
from fbrl.envs.vector_env import ActionSet
from fbrl.evaluation.evaluation import Evaluation, Policy, evaluate
from fbrl.evaluation.policies import make_policy
from fbrl.presets import nearest_preset
from fbrl.pretrained import PREFIX
from fbrl.run_files import METRICS_NAME
from fbrl.run_seeds import fresh_seed
from fbrl.transforms import ScoringReward

Row = dict[str, Any]
"""One result, flat, as it is written to tables."""


@dataclass(frozen=True)
class EvaluatedPolicy:
    """Whoever is evaluated: an agent, or a baseline, which was not trained.

    Attributes:
        name: The path it was loaded from, or a baseline's name.
        policy: Reads the observation and writes ``action``.
        action_set: What ``policy`` chooses from.
        config: How it was trained; None for a baseline.
        frames: Frames that it was trained on; None for a baseline.
        reward: What it was trained with; None for a baseline.
    """

    name: str
    policy: Policy
    action_set: ActionSet = "default"
    config: TrainConfig | None = None
    frames: int | None = None
    reward: ScoringReward | None = None


@dataclass(frozen=True)
class PooledSeeds:
    """Several seeds of one configuration as one result.

    Attributes:
        label: What tells the configuration from the others.
        mode: How actions were chosen.
        seeds: How many there are.
        scenarios: Where they played.
        scores: Mean goal differences, one row per seed and one column per scenario.
        goal_difference: Their interquartile mean.
    """

    label: str
    mode: str
    seeds: int
    scenarios: tuple[str, ...]
    scores: tuple[tuple[float, ...], ...]
    goal_difference: Estimate


def trained(path: Path, device: torch.device) -> EvaluatedPolicy:
    """The agent of a checkpoint, of a run's latest one, or of ``pretrained:NAME``.

    Raises:
        CheckpointError: There is none, or it is damaged.
        UnknownNameError: fbrl brings no agent of this name along.
        ConfigError: The density of its reward can't be read.
    """
    agent = load_agent(path, device)
    # Not found out when its turn comes, after the matches of others.
    reward = make_training_reward(agent.config, agent.run_dir)
    policy = agent.model.get_collection_policy()
    return EvaluatedPolicy(str(path), policy, "default", agent.config, agent.frames, reward)


def baseline(name: str) -> EvaluatedPolicy:
    """A policy without a network: random, idle or builtin-ai.

    Raises:
        UnknownNameError: There is none of this name.
    """
    policy = make_policy(name)
    return EvaluatedPolicy(name, policy, policy.action_set)


def play(
    evaluated: EvaluatedPolicy,
    scenario: str,
    *,
    episodes: int,
    seed: int,
    num_envs: int,
    greedy: bool,
    device: torch.device,
    on_progress: Callable[[int], None],
) -> Evaluation:
    """Plays fresh matches; the same arguments on the same machine give the same matches.

    Rewards are those that the agent was trained with; a baseline is shown the analytics reward.

    Args:
        evaluated: Who plays.
        scenario: Where.
        episodes: How many matches at least, see :func:`fbrl.evaluation.evaluation.play_matches`.
        seed: Of the matches, see :func:`fbrl.run_seeds.fresh_seed`, and of the sampled actions.
        num_envs: Matches at a time.
        greedy: Take the most probable action instead of sampling.
        device: Where the policy runs.
        on_progress: Called with the number of matches finished so far.

    Raises:
        EngineNotInstalledError: gfootball is missing.
    """
    config, reward = evaluated.config, evaluated.reward
    env = make_env(
        scenario,
        num_envs=num_envs,
        reward="analytics" if reward is None else reward.clone(),
        observation="simple115" if config is None else make_agent_observation(config),
        action_set=evaluated.action_set,
        frame_skip=1 if config is None else config.ppo.frame_skip,
        seed=fresh_seed(config, scenario, seed),
    )
    cuda = [device] if device.type == "cuda" else []
    with contextlib.closing(env), torch.random.fork_rng(devices=cuda):
        torch.manual_seed(seed)
        policy = evaluated.policy
        return evaluate(
            env, policy, episodes, greedy=greedy, device=device, on_progress=on_progress
        )


def configurations(policies: Sequence[EvaluatedPolicy]) -> dict[str, str]:
    """For the name of each agent what tells its configuration from the others', reward first.

    Raises:
        RunGroupError: A seed comes twice in a configuration.
    """
    groups = _groups(policies)
    labels = {str(run.run_dir): group.label for group in groups for run in group.runs}
    return labels | {one.name: one.name for one in policies if _is_pretrained(one)}


def result_row(
    evaluated: EvaluatedPolicy,
    configuration: str | None,
    scenario: str,
    mode: str,
    seed: int,
    evaluation: Evaluation,
) -> Row:
    """An evaluation as numbers: means over the matches, and the goal difference's interval.

    The scenario and the seed are those of :func:`play`, the configuration is of
    :func:`configurations`, None for a baseline, and the mode is ``"sample"`` or ``"greedy"``.
    """
    config = evaluated.config
    low, high = evaluation.interval
    won, drawn, lost = evaluation.results
    means = {}
    for name in evaluation.matches:
        mean = evaluation.mean(name)
        # The sums over a match are told from the name of the reward, as in the environment.
        column = EPISODE_PREFIX + name if name.startswith("reward") else name
        means[column] = None if math.isnan(mean) else mean
    return {
        "policy": evaluated.name,
        "configuration": configuration,
        "reward": None if config is None else config.reward,
        "preset": None if config is None else nearest_preset(config),
        "trained_on": None if config is None else config.scenario,
        "seed": None if config is None else config.seed,
        "frames": evaluated.frames,
        "scenario": scenario,
        "mode": None if config is None else mode,
        "evaluation_seed": fresh_seed(config, scenario, seed),
        "matches": len(evaluation.goal_differences),
        "goal_difference": means.pop("goal_difference"),
        "goal_difference_low": low,
        "goal_difference_high": high,
        "won": won,
        "drawn": drawn,
        "lost": lost,
        **means,
    }


def pool_seeds(policies: Sequence[EvaluatedPolicy], rows: Sequence[Row]) -> list[PooledSeeds]:
    """The seeds of each configuration together.

    All of them played in the same scenarios and modes. Agents that were trained on fewer frames, as
    earlier checkpoints were, count for themselves.

    Raises:
        RunGroupError: A seed comes twice in a configuration.
    """
    groups = _groups(policies)
    modes = list(dict.fromkeys(row["mode"] for row in rows if row["mode"]))
    return [_pool(group, mode, rows) for group in groups for mode in modes]


def improvements(pooled: Sequence[PooledSeeds]) -> list[tuple[PooledSeeds, PooledSeeds, Estimate]]:
    """How probable it is that a seed of one configuration scores more than one of another.

    Returns:
        The better one of each pair with the same mode and scenarios, the other, the probability.
    """
    found = []
    for first, second in itertools.combinations(pooled, 2):
        if (first.mode, first.scenarios) == (second.mode, second.scenarios):
            estimate = probability_of_improvement(first.scores, second.scores)
            if estimate.value < 0.5:
                first, second = second, first
                estimate = probability_of_improvement(first.scores, second.scores)
            found.append((first, second, estimate))
    return found


def training_row(evaluated: EvaluatedPolicy, threshold: float, tolerance: float) -> Row | None:
    """What the log of a training says of its convergence; None where there is no log.

    It is ``frames_until_threshold``, as :func:`fbrl.analysis.run_log.frames_until` finds them with
    this threshold and tolerance, and ``paper_goal_difference``, the figure at the training's end.

    Raises:
        RunLogError: The log is damaged.
    """
    run_dir = Path(evaluated.name)
    if evaluated.config is None or not (run_dir / METRICS_NAME).is_file():
        return None
    log = read_run_log(run_dir)
    goals = log.metric(GOAL_DIFFERENCE)
    return {
        "policy": evaluated.name,
        "frames": int(log.frames[-1]),
        "threshold": threshold,
        "tolerance": tolerance,
        "frames_until_threshold": frames_until(log.frames, goals, threshold, tolerance),
        "paper_goal_difference": paper_goal_difference(log, int(log.frames[-1])),
    }


def _is_pretrained(evaluated: EvaluatedPolicy) -> bool:
    return evaluated.name.startswith(PREFIX)


def _groups(policies: Sequence[EvaluatedPolicy]) -> list[RunGroup]:
    runs, frames = [], []
    for evaluated in policies:
        # A pretrained agent was chosen from several seeds: it is no fair one among others.
        if evaluated.config and evaluated.frames is not None and not _is_pretrained(evaluated):
            runs.append(RunLog(Path(evaluated.name), evaluated.config))
            frames.append(evaluated.frames)
    return group_runs(runs, ("reward",), frames)


def _pool(group: RunGroup, mode: str, rows: Sequence[Row]) -> PooledSeeds:
    scores: dict[str, dict[str, float]] = {str(run.run_dir): {} for run in group.runs}
    for row in rows:
        if row["policy"] in scores and row["mode"] == mode:
            scores[row["policy"]][row["scenario"]] = row["goal_difference"]
    table = tuple(tuple(seed.values()) for seed in scores.values())
    scenarios = tuple(next(iter(scores.values())))
    return PooledSeeds(group.label, mode, len(table), scenarios, table, interquartile_mean(table))
