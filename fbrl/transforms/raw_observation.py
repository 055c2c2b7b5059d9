"""What the transforms expect of a match's raw observation, and how they say so when it differs."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import Transform

from fbrl.envs.observation import OBSERVATION_SPACE

__all__ = ["FIELD_SHAPES", "FLOAT_FIELDS", "RawObservationTransform", "read_fields"]

FIELD_SHAPES: dict[str, tuple[int, ...]] = {
    **{key: space.shape or () for key, space in OBSERVATION_SPACE.items()},
    "action_memory": (3,),
}
"""Shape of each raw field of one match, after the batch dimensions; and of ``ActionMemory``'s."""

_FLOATS = (torch.float32, torch.float64)
_INTEGERS = (torch.int64, torch.int32, torch.int16, torch.int8)
FLOAT_FIELDS = {key for key, space in OBSERVATION_SPACE.items() if space.dtype == np.float32}
"""Those that are floating point; the others are integers."""


class RawObservationTransform(Transform):
    """Base of the transforms that compute one entry from the raw observation of a state alone.

    A subclass names what it reads (:attr:`fields`) and writes (:attr:`out_key`), and computes
    (:meth:`compute`). The spec follows from what it computes of zeros.

    Args:
        in_keys: where to find the fields, in the order of the class's.
        out_keys: where to write the entry.

    Raises:
        ValueError: if there are more or fewer keys than these.
    """

    fields: tuple[str, ...]
    """Keys of :data:`FIELD_SHAPES`, in the order in which :meth:`compute` is given them."""

    out_key: str
    """The usual key of what is computed."""

    def __init__(
        self,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        super().__init__(
            in_keys=list(self.fields) if in_keys is None else in_keys,
            out_keys=[self.out_key] if out_keys is None else out_keys,
        )
        if len(self.in_keys) != len(self.fields) or len(self.out_keys) != 1:
            raise ValueError(
                f"{type(self).__name__}: in_keys must name {len(self.fields)} keys for "
                f"{self.fields}, in this order, and out_keys one; got in_keys={self.in_keys} and "
                f"out_keys={self.out_keys}."
            )

    @abstractmethod
    def compute(self, *fields: Any) -> torch.Tensor:
        """Returns the entry (*batch, ...) for the fields (*batch, ...) of some states."""

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        fields = read_fields(next_tensordict, self.in_keys, self.fields, type(self).__name__)
        return next_tensordict.set(self.out_keys[0], self.compute(*fields))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    _reset_on_native_autoreset = _reset

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Computes it for stored observations, under ``"next"`` too where they are there."""
        self._call(tensordict)
        if ("next", self.in_keys[0]) in tensordict.keys(include_nested=True):
            self._call(tensordict.get("next"))
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Adds the entry to the observation."""
        present = observation_spec.keys(True, True)
        zeros = {key: observation_spec[key].zero() for key in self.in_keys if key in present}
        example = TensorDict(batch_size=observation_spec.shape, device=observation_spec.device)
        for key, value in zeros.items():
            example.set(key, value)
        entry = self._call(example).get(self.out_keys[0])
        kind = Binary if entry.dtype == torch.bool else Unbounded
        observation_spec[self.out_keys[0]] = kind(
            shape=entry.shape, dtype=entry.dtype, device=observation_spec.device
        )
        return observation_spec


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
        allowed = _FLOATS if field in FLOAT_FIELDS else _INTEGERS
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
