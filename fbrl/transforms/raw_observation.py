"""What the transforms expect of a match's raw observation, and how they say so when it differs."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase

__all__ = ["FIELD_SHAPES", "read_fields"]

FIELD_SHAPES: dict[str, tuple[int, ...]] = {
    "ball": (3,),
    "ball_direction": (3,),
    "left_team": (11, 2),
    "left_team_direction": (11, 2),
    "left_team_tired_factor": (11,),
    "left_team_active": (11,),
    "left_team_roles": (11,),
    "right_team": (11, 2),
    "right_team_direction": (11, 2),
    "right_team_tired_factor": (11,),
    "right_team_active": (11,),
    "right_team_roles": (11,),
    "active": (),
    "designated": (),
    "ball_owned_team": (),
    "ball_owned_player": (),
    "game_mode": (),
    "score": (2,),
    "steps_left": (),
    "sticky_actions": (10,),
    "action_memory": (3,),
}
"""Shape of each raw field of one match, after the batch dimensions; and of ``ActionMemory``'s."""

_FLOATS = (torch.float32, torch.float64)
_INTEGERS = (torch.int64, torch.int32, torch.int16, torch.int8)
_INTEGER_FIELDS = {
    "left_team_active",
    "left_team_roles",
    "right_team_active",
    "right_team_roles",
    "active",
    "designated",
    "ball_owned_team",
    "ball_owned_player",
    "game_mode",
    "score",
    "steps_left",
    "sticky_actions",
    "action_memory",
}


def read_fields(
    tensordict: TensorDictBase, keys: Sequence[NestedKey], fields: Sequence[str], reader: str
) -> list[torch.Tensor]:
    """Reads raw observation fields and checks their shapes and dtypes.

    Args:
        tensordict: a tensordict of any batch shape.
        keys: where each field is found in ``tensordict``.
        fields: the names of the fields (keys of :data:`FIELD_SHAPES`), in the same order.
        reader: who reads; named in the error messages.

    Returns:
        The tensors, in the order of ``fields``, with the shapes of :data:`FIELD_SHAPES`.

    Raises:
        KeyError: a key is missing.
        ValueError: a tensor has another shape than the field of one match.
        TypeError: positions are not floating point, or indices are not integers.
    """
    if not isinstance(tensordict, TensorDictBase):
        raise TypeError(f"{reader} was given a {type(tensordict).__name__}; expected a TensorDict.")
    batch_dims = tensordict.batch_dims
    tensors = []
    for key, field in zip(keys, fields, strict=True):
        tensor = tensordict.get(key, None)
        if tensor is None:
            raise KeyError(_missing(tensordict, key, field, reader))
        shape = tensor.shape[batch_dims:]
        if shape == (1,) and FIELD_SHAPES[field] == ():
            # TorchRL's GymWrapper gives the scalars of a single environment a dimension of one.
            tensor = tensor.squeeze(-1)
        elif shape != FIELD_SHAPES[field]:
            raise ValueError(_wrong_shape(tensordict, tensor, key, field, reader))
        allowed = _INTEGERS if field in _INTEGER_FIELDS else _FLOATS
        if tensor.dtype not in allowed:
            names = " or ".join(str(dtype) for dtype in allowed)
            raise TypeError(
                f"{reader}: {key!r} has dtype {tensor.dtype}, but must be {names}. "
                f"Convert it before this transform, or take it from fbrl.envs.FootballEnv."
            )
        tensors.append(tensor)
    return tensors


def _missing(tensordict: TensorDictBase, key: NestedKey, field: str, reader: str) -> str:
    present = sorted(str(k) for k in tensordict.keys(True, True))
    return (
        f"{reader}: {key!r} is missing from the tensordict, which has {present}. "
        f"Use an environment that gives the raw match observation, such as fbrl.envs.FootballEnv, "
        f"keep {key!r} in the tensordict, or name the key that holds {field!r} in in_keys."
    )


def _wrong_shape(
    tensordict: TensorDictBase, tensor: torch.Tensor, key: NestedKey, field: str, reader: str
) -> str:
    expected = (*tensordict.batch_size, *FIELD_SHAPES[field])
    return (
        f"{reader}: {key!r} has shape {tuple(tensor.shape)}, but a tensordict of batch size "
        f"{tuple(tensordict.batch_size)} needs {expected}. Teams of fewer than 11 players are "
        f"padded with -1 to 11."
    )
