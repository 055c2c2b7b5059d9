"""A reward of your own: fbrl-train SCENARIO --reward pressing:PressingReward."""

from torch import Tensor, where

from fbrl.transforms import Memory, Observation, ShapedReward


class PressingReward(ShapedReward):
    """Pay for taking the ball off the other team.

    Args:
        bonus: What each time is worth, in goals.
    """

    def __init__(self, bonus: float = 0.05) -> None:
        reads = ("ball", "ball_owned_team")
        super().__init__(observations=reads, parts=("reward_pressing",), memory=("last_team",))
        self.bonus = bonus

    def _first_memory(self, observation: Observation) -> Memory:
        return {"last_team": observation["ball_owned_team"]}

    def _remember(self, memory: Memory, observation: Observation, scoring: Tensor) -> Memory:
        team = observation["ball_owned_team"]
        return {"last_team": where(team == -1, memory["last_team"], team)}

    def _pay(self, memory: Memory, remembered: Memory, observation: Observation) -> tuple[Tensor]:
        won = (memory["last_team"] == 1) & (remembered["last_team"] == 0)
        return (self.bonus * won,)
