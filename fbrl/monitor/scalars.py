"""Every name that a run has in TensorBoard, what it means, and the charts that show it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fbrl.envs.actions import ACTION_NAMES

GOAL_DIFFERENCE_NAMES = (
    "evaluation/goal_difference",
    "evaluation/goal_difference_low",
    "evaluation/goal_difference_high",
)
"""The mean and its interval: what runs are compared by on TensorBoard's page HParams."""

ACTION_TAGS = tuple(f"policy/action_{name}" for name in ACTION_NAMES)
"""One for each action, in the order of their indices."""

SCALARS: Mapping[str, str] = {
    "match/goal_difference": "goals for minus goals against, mean of the last 100 matches",
    "match/goals_for": "goals of the agent's team, likewise",
    "match/goals_against": "goals of the opponent, likewise",
    "match/win_share": "share of the last 100 matches that were won",
    "match/draw_share": "share that was drawn",
    "match/loss_share": "share that was lost",
    "match/length": "frames of a match, mean of the last 100 matches",
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
    "evaluation/length": "frames of a fresh match, mean",
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


def chart_layout(reward_names: tuple[str, ...]) -> Mapping[str, Mapping[str, Any]]:
    """The page Custom Scalars, as ``SummaryWriter.add_custom_scalars`` takes it.

    Args:
        reward_names: The reward's total and its parts, such as ``reward/scoring``.
    """
    shaping = [name for name in reward_names if name not in ("reward/total", "reward/scoring")]
    passes = [f"policy/action_{height}_pass" for height in ("short", "high", "long")]
    return {
        "Goals": {
            "Goal difference on fresh matches, 95 % interval": [
                "Margin",
                list(GOAL_DIFFERENCE_NAMES),
            ],
            "Goal difference, training and fresh matches": _lines(
                "match/goal_difference", "evaluation/goal_difference"
            ),
            "Goals per match": _lines("match/goals_for", "match/goals_against"),
            "Goals per fresh match": _lines("evaluation/goals_for", "evaluation/goals_against"),
            "Won, drawn, lost": _lines("match/win_share", "match/draw_share", "match/loss_share"),
        },
        "Reward": {
            "Parts of the reward per match, against goals": _lines(*reward_names),
            "Shaping alone": _lines(*shaping),
        },
        "Play": {
            "Possession": _lines("play/possession_share", "evaluation/possession_share"),
            "Passes and shots per match": _lines("play/passes", "play/shots"),
            "The same on fresh matches": _lines("evaluation/passes", "evaluation/shots"),
            "Frames of a match": _lines("match/length", "evaluation/length"),
            "Share of passing actions": _lines(*passes),
            "Share of shots and idling": _lines("policy/action_shot", "policy/action_idle"),
        },
        "PPO": {
            "Entropy": _lines("ppo/entropy"),
            "Divergence and clipping": _lines("ppo/approx_kl", "ppo/clip_fraction"),
            "Explained variance": _lines("ppo/explained_variance"),
            "Losses": _lines("ppo/policy_loss", "ppo/value_loss"),
            "Gradient norm": _lines("ppo/gradient_norm"),
            "Learning rate": _lines("ppo/learning_rate"),
        },
        "Speed": {
            "Frames per second": _lines("time/frames_per_second"),
            "Cores in use while playing": _lines("time/collect_cores"),
            "Seconds of an iteration": _lines("time/collect_seconds", "time/update_seconds"),
        },
    }


def _lines(*names: str) -> list[Any]:
    # TensorBoard takes them as regular expressions, which match from the start.
    return ["Multiline", [f"{name}$" for name in names]]
