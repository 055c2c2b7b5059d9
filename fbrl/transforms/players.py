"""What the controlled player sees: numbers relative to it, players by their distance."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torchrl.envs import Compose

from fbrl.transforms.action_memory import ActionMemory
from fbrl.transforms.players_features import players_features
from fbrl.transforms.players_table import NUM_FEATURES, PLAYERS_FEATURES
from fbrl.transforms.raw_observation import RawObservationTransform

__all__ = ["PLAYERS_FEATURES", "Players"]


class Players(RawObservationTransform):
    """The match as the controlled player sees it, in numbers of about unit size.

    Writes ``players``, a float32 tensor of shape ``(*batch, 274)``; each number has a name and a
    meaning in :data:`~fbrl.transforms.players_table.PLAYERS_FEATURES`. First what there is once:
    what is held and was done lately, the controlled player, the ball, the goals, the game. Then ten
    team-mates and eleven opponents, each sorted by distance from the controlled player, nearest
    first.

    Positions are relative to the controlled player, in multiples of 25 metres along the axes of the
    pitch, to which the actions' directions belong; velocities in multiples of 5 m/s (10 m/s for the
    ball). Where nobody is controlled the ball stands in for the player. Who isn't there (fewer than
    eleven a side, or sent off) has zeros throughout, after those who are.

    It is computed on the CPU, wherever the observations are.

    Args:
        in_keys: where to find the raw observations and ``action_memory``, as
            :class:`ActionMemory` writes it before, in the order of the defaults.
        out_keys: where to write the vector.

    Raises:
        ValueError: if there are more or fewer keys than these.

    Examples:
        >>> from fbrl.envs import make_env
        >>> env = make_env("academy_empty_goal", num_envs=2, observation="players", seed=0)
        >>> state = env.reset()["players"]
        >>> state.shape
        torch.Size([2, 274])
        >>> numbers = dict(zip(PLAYERS_FEATURES, state[0].tolist()))
        >>> numbers["ball_is_free"], numbers["opponent_1_is_keeper"], numbers["opponent_2_is_there"]
        (1.0, 1.0, 0.0)
    """

    fields = (
        "left_team",
        "left_team_direction",
        "left_team_tired_factor",
        "left_team_active",
        "left_team_roles",
        "right_team",
        "right_team_direction",
        "right_team_tired_factor",
        "right_team_active",
        "right_team_roles",
        "ball",
        "ball_direction",
        "active",
        "designated",
        "ball_owned_team",
        "ball_owned_player",
        "game_mode",
        "score",
        "steps_left",
        "sticky_actions",
        "action_memory",
    )
    out_key = "players"

    def compute(self, *fields: torch.Tensor) -> torch.Tensor:
        """Returns the vector (*batch, 274)."""
        shape, device = fields[-1].shape[:-1], fields[-1].device
        arrays = [rows.numpy() for rows in _rows_of_matches(fields, shape, device)]
        numbers = torch.from_numpy(players_features(dict(zip(self.fields, arrays, strict=True))))
        return numbers.view(*shape, NUM_FEATURES).to(device)


def _rows_of_matches(
    fields: Sequence[torch.Tensor], shape: torch.Size, device: torch.device
) -> Sequence[torch.Tensor]:
    """The fields on the CPU with one leading dimension, untouched where they are so already."""
    if device.type != "cpu":
        fields = [field.cpu() for field in fields]
    if len(shape) != 1:
        fields = [field.reshape(-1, *field.shape[len(shape) :]) for field in fields]
    return fields


def players_with_memory() -> Compose:
    """The observation ``players`` for an environment without an action memory."""
    return Compose(ActionMemory(), Players())
