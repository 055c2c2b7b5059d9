"""Every name that a run has in TensorBoard, and what it means."""

from __future__ import annotations

from collections.abc import Mapping

from fbrl.envs.actions import ACTION_NAMES

ACTION_TAGS = tuple(f"policy/action_{name}" for name in ACTION_NAMES)
"""One for each action, in the order of their indices."""

SCALARS: Mapping[str, str] = {
    "match/goal_difference": "goals for minus goals against, mean of the last 100 matches",
    "match/goals_for": "goals of the agent's team, likewise",
    "match/goals_against": "goals of the opponent, likewise",
    "match/win_share": "share of the last 100 matches that were won",
    "match/draw_share": "share that was drawn",
    "match/loss_share": "share that was lost",
    "match/length": "steps of a match, mean of the last 100 matches",
    "match/count": "matches finished since the start",
    "reward/total": "sum over a match of what PPO maximises, mean of the last 100 matches",
    "reward/scoring": "its part from goals",
    "reward/start_density": "its part from where assists start (analytics)",
    "reward/end_density": "its part from where assists end (analytics)",
    "reward/potential": "its part from the change of the potential, without discount (potential)",
    "reward/checkpoint": "its part from checkpoints (checkpoints)",
    "play/possession_share": "steps with the ball over those in which either team had it, mean of "
    "those of the last 100 matches in which anybody had it",
    "play/passes": "passes between controlled players in a match, mean of the last 100 matches",
    "play/shots": "shots of the agent's team in a match, likewise",
    **{
        tag: f"share of the iteration's steps in which the action was {name}"
        for tag, name in zip(ACTION_TAGS, ACTION_NAMES, strict=True)
    },
    "ppo/policy_loss": "clipped surrogate",
    "ppo/value_loss": "weighted squared error of the critic",
    "ppo/entropy": "of the policy, in nats; ln 19 = 2.94 is uniform",
    "ppo/approx_kl": "estimated divergence of the new policy from the old",
    "ppo/clip_fraction": "share of the probability ratios that were clipped",
    "ppo/explained_variance": "of the returns by the critic; 1 is perfect",
    "ppo/gradient_norm": "before it is scaled down",
    "ppo/learning_rate": "of this update",
    "time/frames_per_second": "of collection and updates together, without evaluations",
    "time/collect_seconds": "of the iteration",
    "time/update_seconds": "of the iteration",
    "time/collect_cores": "processor cores in use while matches are played, on average",
    "evaluation/goal_difference": "goals for minus goals against on fresh matches, mean",
    "evaluation/goal_difference_low": "lower end of its 95 % interval",
    "evaluation/goal_difference_high": "upper end",
    "evaluation/goals_for": "goals of the agent's team in a fresh match, mean",
    "evaluation/goals_against": "goals of the opponent, likewise",
    "evaluation/length": "steps of a fresh match, mean",
    "evaluation/possession_share": "as in play/, of the fresh matches",
    "evaluation/passes": "likewise",
    "evaluation/shots": "likewise",
    "evaluation/matches": "fresh matches that were played",
    "evaluation/seconds": "time that the evaluation took, pictures included",
}
"""The scalars. The x axis is environment frames throughout."""

BALL_POSITIONS = "evaluation/ball_positions"
MATCH_VIDEO = "evaluation/match"

IMAGES: Mapping[str, str] = {
    BALL_POSITIONS: "where the agent had the ball in the fresh matches, beside the densities",
    MATCH_VIDEO: "one fresh match from above, at most its first 40 seconds, at twice their speed",
}
"""The pictures."""
