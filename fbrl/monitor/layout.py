"""The charts that TensorBoard's page Custom Scalars shows, and in which order."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def chart_layout(reward_names: tuple[str, ...]) -> Mapping[str, Mapping[str, Any]]:
    """The layout in the form that ``SummaryWriter.add_custom_scalars`` documents.

    Args:
        reward_names: The reward's total and its parts, such as ``reward/scoring``.
    """
    passes = [f"policy/action_{height}_pass" for height in ("short", "high", "long")]
    return {
        "Goals": {
            "Goal difference on fresh matches, 95 % interval": [
                "Margin",
                [
                    "evaluation/goal_difference",
                    "evaluation/goal_difference_low",
                    "evaluation/goal_difference_high",
                ],
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
            "Shaping alone": _lines(
                *(name for name in reward_names if name not in ("reward/total", "reward/scoring"))
            ),
        },
        "Play": {
            "Possession": _lines("play/possession_share", "evaluation/possession_share"),
            "Passes and shots per match": _lines("play/passes", "play/shots"),
            "The same on fresh matches": _lines("evaluation/passes", "evaluation/shots"),
            "Steps of a match": _lines("match/length", "evaluation/length"),
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
