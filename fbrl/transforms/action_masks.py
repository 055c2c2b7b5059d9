"""Which actions may be chosen: those that do something, and those that an expert would consider."""

from __future__ import annotations

import torch
from torch import Tensor

from fbrl.envs.actions import ACTION_NAMES
from fbrl.transforms.action_memory import KICKS
from fbrl.transforms.raw_observation import Keys, RawObservationTransform

_IDLE, _LONG_PASS, _HIGH_PASS, _SHOT = (
    ACTION_NAMES.index(name) for name in ("idle", "long_pass", "high_pass", "shot")
)
_SLIDING, _DRIBBLE = ACTION_NAMES.index("sliding"), ACTION_NAMES.index("dribble")


class EngineActionMask(RawObservationTransform):
    """Mask the actions that the engine ignores: they lead to the state that idle leads to.

    Writes ``action_mask``, bool of shape ``(*batch, 19)``, false for

    - the direction that is held;
    - sprint and dribble while they are held;
    - release direction, release sprint and release dribble while there is nothing to release.

    So three of the 19 actions are masked in each state, and nothing that can be reached is lost.

    Other actions are said to do nothing in some states, but whether the engine heeds a kick or a
    slide depends on what no observation shows, and changes within a step (``humancontroller.cpp``).
    In 3,569 states of six scenarios, each gone on from with every action: kicks made a difference
    in 86 % of the states in which an opponent had the ball and in 88 % of those in which nobody had
    it and it was further than 0.03 away, since the engine keeps them for when the player gets it;
    another kick right after one in 9 %; sliding with the ball at one's feet in 2 %.

    For a policy that reads the mask see :func:`fbrl.models.build_actor_critic`; TorchRL's
    ``ActionMask``, put after this one, makes random actions heed it.

    Args:
        in_keys: where to find the raw observations, in the order of :attr:`fields`.
        out_keys: where to write the mask.

    Raises:
        ValueError: if there are more or fewer keys than these.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> held = torch.zeros(1, 10, dtype=torch.int8)
        >>> held[0, [4, 8]] = 1  # right and sprint
        >>> state = TensorDict(sticky_actions=held, batch_size=[1])
        >>> mask = EngineActionMask()(state)["action_mask"][0]
        >>> [ACTION_NAMES[action] for action in (~mask).nonzero().flatten()]
        ['right', 'sprint', 'release_dribble']
    """

    fields: tuple[str, ...] = ("sticky_actions",)
    out_key = "action_mask"

    def compute(self, *fields: Tensor) -> Tensor:
        """Returns which actions may be chosen, bool (*batch, 19)."""
        held = fields[0].bool()
        free = ~held
        direction = held[..., :8].any(-1, keepdim=True)
        always = torch.ones_like(direction)
        any_kick = always.expand(*always.shape[:-1], len(KICKS))
        sprint, dribble = slice(8, 9), slice(9, 10)
        # Idle, directions, kicks, sprint, release direction, release sprint, sliding, dribble,
        # release dribble.
        columns = [always, free[..., :8], any_kick, free[..., sprint], direction]
        columns += [held[..., sprint], always, free[..., dribble], held[..., dribble]]
        return torch.cat(columns, -1)


class ExpertActionMask(EngineActionMask):
    """Mask, besides what the engine ignores, what experts think is a mistake.

    These are opinions: they take away what can be done, sometimes what would have scored. They are
    those of PARIS (football-paris, ``encoders/encoder_basic.py``) and, for other bounds, TiZero's
    (Lin et al. 2023). Beyond :class:`EngineActionMask`, ``action_mask`` is false for

    - kicks and dribble, while an opponent has the ball, or nobody has it and, in normal play, it is
      further than 0.03 from the controlled player;
    - sliding in all other states, and while dribble is held;
    - the shot from outside the zone before their goal, and the long and the high pass within it;
    - idle, if it is so wished.

    Distances are in pitch units, as PARIS has them. There is always something that may be chosen:
    directions are left out only while they are held.

    Args:
        shot_from_x: where the zone begins; it ends at the goal line. TiZero: 0.4.
        shot_half_width: half its width. TiZero: 0.3.
        mask_idle: whether idle is masked. TiZero: it is.
        in_keys: as in :class:`EngineActionMask`.
        out_keys: likewise.

    Raises:
        ValueError: if there are more or fewer keys than these.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> state = TensorDict(
        ...     sticky_actions=torch.zeros(10, dtype=torch.int8),
        ...     left_team=torch.zeros(11, 2),
        ...     ball=torch.tensor([0.01, 0.0, 0.1]),
        ...     active=torch.tensor(3),
        ...     ball_owned_team=torch.tensor(0),
        ...     game_mode=torch.tensor(0),
        ... )
        >>> mask = ExpertActionMask()(state)["action_mask"]
        >>> [ACTION_NAMES[action] for action in mask.nonzero().flatten()[9:]]
        ['long_pass', 'high_pass', 'short_pass', 'sprint', 'dribble']
    """

    fields = ("sticky_actions", "left_team", "ball", "active", "ball_owned_team", "game_mode")

    def __init__(
        self,
        shot_from_x: float = 0.64,
        shot_half_width: float = 0.27,
        mask_idle: bool = False,
        in_keys: Keys = None,
        out_keys: Keys = None,
    ) -> None:
        super().__init__(in_keys, out_keys)
        self.shot_from_x = shot_from_x
        self.shot_half_width = shot_half_width
        self.mask_idle = mask_idle

    def compute(self, *fields: Tensor) -> Tensor:
        """See :meth:`EngineActionMask.compute`."""
        mask = super().compute(*fields)
        held, left_team, ball, active, team, game_mode = fields
        # As PARIS has it: the ball is ours, or nobody's and near, or nobody's in a stopped game.
        index = active.long().clamp(min=0)[..., None, None].expand(*active.shape, 1, 2)
        place = left_team.gather(-2, index).squeeze(-2)
        distance = torch.linalg.vector_norm(ball[..., :2] - place, dim=-1)
        has_chance = (team != 1) & ~((team == -1) & (distance > 0.03) & (game_mode == 0))
        for action in (*KICKS, _DRIBBLE):
            mask[..., action] &= has_chance
        mask[..., _SLIDING] = ~has_chance & (held[..., 9] == 0)
        x, y = ball[..., 0], ball[..., 1]
        in_zone = (x >= self.shot_from_x) & (x <= 1) & (y.abs() <= self.shot_half_width)
        mask[..., _SHOT] &= in_zone
        mask[..., _LONG_PASS] &= ~in_zone
        mask[..., _HIGH_PASS] &= ~in_zone
        if self.mask_idle:
            mask[..., _IDLE] = False
        return mask
