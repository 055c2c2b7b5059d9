"""What happens in a match besides its reward: goals, possession, passes and shots."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from fbrl.density.coordinates import METRES_PER_UNIT
from fbrl.transforms.ball_control import NOBODY, Observation, ball_lost, in_control, last_carrier
from fbrl.transforms.memory import MemoryTransform, latest_before_steps, totals_after_steps
from fbrl.transforms.raw_observation import read_fields

PLAY_STATISTICS = (
    "goals_for",
    "goals_against",
    "possession",
    "opponent_possession",
    "passes",
    "shots",
)
"""Names of the totals, in their order."""

_FIELDS = ("ball", "ball_direction", "active", "ball_owned_team", "ball_owned_player", "game_mode")

# On 20,000 steps of scripted and built-in play, with shots told from passes by the action pressed,
# shots flew at 2 to 3.3 metres a step (100 ms) and passes at 1.2 to 2.1.
_SHOT_METRES_PER_STEP = 2.0
_SHOT_FROM_X = 0.4
# The posts stand at 0.044: a shot may miss them by 4.7 metres.
_SHOT_HALF_WIDTH = 0.1

Facts = dict[str, Tensor]
"""What a step led to, as far as it doesn't depend on the steps before; each of shape (...)."""


class PlayStatistics(MemoryTransform):
    """Count an episode's goals, possession, passes and shots so far.

    ``play_statistics`` (..., 6) float32 holds the totals since the reset, named by
    :data:`PLAY_STATISTICS`; at an episode's last step they are the match's figures:

    - ``goals_for``, ``goals_against``: from ``reward_scoring``, so this transform comes after the
      reward;
    - ``possession``, ``opponent_possession``: steps after which a left (right) player had the ball;
    - ``passes``: the controlled player has the ball and the controlled player who had it last was
      another one, with no opponent's possession and no stop of the game in between: exactly what
      :class:`~fbrl.transforms.AssistDensityReward` takes for a transition;
    - ``shots``: the ball, last had by the left team or by nobody yet, flies freely at 20 m/s or
      more from the last 33 metres towards a point within 8.4 metres of the goal's centre; or a goal
      is scored without that. A flight counts once, whoever's it is; slow shots are not seen.

    ``play_memory`` (..., 2) int64 carries the last controlled player with the ball (-1 for none)
    and whether the ball is the left team's with no shot counted since it had it. Like a step
    counter's count both live in the tensordict.

    Examples:
        >>> from fbrl.envs import make_env
        >>> env = make_env("academy_empty_goal_close", num_envs=2, seed=0)
        >>> env.rollout(3)["next", "play_statistics"].shape
        torch.Size([2, 3, 6])
    """

    def __init__(self) -> None:
        super().__init__(in_keys=list(_FIELDS), out_keys=["play_statistics", "play_memory"])

    @property
    def memory_keys(self) -> tuple[NestedKey, ...]:
        """What a step, and :meth:`label`, needs from what came before."""
        return ("play_memory", "play_statistics")

    def begin(self, state: TensorDictBase) -> None:
        """Sets the totals and the memory of episodes that begin with these observations."""
        memory = _first_memory(self._facts(state))
        state.set("play_memory", memory)
        totals = torch.zeros(*memory.shape[:-1], len(PLAY_STATISTICS), device=memory.device)
        state.set("play_statistics", totals)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        memory, totals = self._before(tensordict)
        for key, entry, size in (
            ("play_statistics", totals, len(PLAY_STATISTICS)),
            ("play_memory", memory, 2),
        ):
            if entry.shape[-1:] != (size,):
                raise ValueError(
                    f"{key!r} has shape {tuple(entry.shape)}; expected (..., {size}), as "
                    "PlayStatistics writes it."
                )
        scoring = next_tensordict.get("reward_scoring", None)
        if scoring is None:
            raise KeyError(
                "PlayStatistics found no 'reward_scoring' in the step's result: put it after one "
                "of fbrl's rewards, such as ScoringReward()."
            )
        facts = self._facts(next_tensordict, scoring)
        next_tensordict.set("play_statistics", totals + _happened(memory, facts))
        return next_tensordict.set("play_memory", _remember(memory, facts))

    def label(self, batch: TensorDictBase, start: TensorDictBase, end: TensorDictBase) -> None:
        """Counts in a whole batch, as :meth:`ScoringReward.label` and after it.

        Under ``"next"`` it writes ``play_statistics`` only.
        """
        following = batch.get("next")
        facts = self._facts(following, following.get("reward_scoring"))
        done = following.get("done").squeeze(-1)
        first = _first_memory(self._facts(batch))
        first[:, 0] = start.get("play_memory")
        carrier, is_ours = first.unbind(-1)
        control, ours, lost = facts["control"], facts["ours"], facts["lost"]
        active = torch.where(lost, NOBODY, facts["active"])
        carrier = latest_before_steps(carrier, done, active, control | lost, 1)
        has = (ours & ~lost).to(is_ours.dtype)
        is_ours = latest_before_steps(is_ours, done, has, ours | lost | facts["at_goal"], 1)
        memory = torch.stack((carrier, is_ours), -1)
        totals = totals_after_steps(start.get("play_statistics"), _happened(memory, facts), done)
        following.set("play_statistics", totals)

        self.begin(end)
        ended = done[:, -1:]
        last = _remember(memory[:, -1], {name: fact[:, -1] for name, fact in facts.items()})
        end.set("play_memory", torch.where(ended, end.get("play_memory"), last))
        end.set("play_statistics", totals[:, -1].masked_fill(ended, 0))

    def _facts(self, tensordict: TensorDictBase, scoring: Tensor | None = None) -> Facts:
        fields = read_fields(tensordict, self.in_keys, _FIELDS, type(self).__name__)
        observation = dict(zip(_FIELDS, fields, strict=True))
        active, team = observation["active"], observation["ball_owned_team"]
        # An episode has no score to begin with.
        scoring = torch.zeros_like(active) if scoring is None else scoring.squeeze(-1)
        in_play = observation["game_mode"] == 0
        free = (team == NOBODY) & in_play
        return {
            "active": active,
            "control": in_control(observation),
            "ours": team == 0,
            "theirs": team == 1,
            "in_play": in_play,
            "lost": ball_lost(observation),
            "at_goal": (free & _flies_at_goal(observation)) | (scoring > 0),
            "scored": scoring > 0,
            "conceded": scoring < 0,
        }


def _first_memory(facts: Facts) -> Tensor:
    # A ball that nobody has had yet may be shot at once, as in academy_empty_goal_close.
    nobody = torch.full_like(facts["active"], NOBODY)
    return _memory(nobody, ~facts["theirs"], facts)


def _remember(memory: Tensor, facts: Facts) -> Tensor:
    carrier, is_ours = memory.unbind(-1)
    return _memory(carrier, (is_ours == 1) & ~facts["at_goal"], facts)


def _memory(carrier: Tensor, is_ours: Tensor, facts: Facts) -> Tensor:
    carrier = last_carrier(carrier, facts["active"], facts["control"], facts["lost"])
    is_ours = (is_ours | facts["ours"]) & ~facts["lost"]
    return torch.stack((carrier, is_ours.long()), -1)


def _happened(memory: Tensor, facts: Facts) -> Tensor:
    """What a step adds to the totals, bool (..., 6)."""
    carrier, is_ours = memory.unbind(-1)
    from_another = (carrier > NOBODY) & (carrier != facts["active"])
    passed = facts["control"] & from_another & facts["in_play"]
    shot = (is_ours == 1) & facts["at_goal"]
    play = (facts["scored"], facts["conceded"], facts["ours"], facts["theirs"], passed, shot)
    return torch.stack(play, -1)


def _flies_at_goal(observation: Observation) -> Tensor:
    ball, direction = observation["ball"], observation["ball_direction"]
    x, y = ball[..., 0], ball[..., 1]
    dx, dy = direction[..., 0], direction[..., 1]
    speed = torch.hypot(dx * METRES_PER_UNIT[0], dy * METRES_PER_UNIT[1])
    # Where it crosses the goal line, multiplied by dx, which is positive.
    offset = y * dx + (1 - x) * dy
    towards = (dx > 0) & (offset.abs() <= _SHOT_HALF_WIDTH * dx)
    return towards & (x >= _SHOT_FROM_X) & (speed >= _SHOT_METRES_PER_STEP)
