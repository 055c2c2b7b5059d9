"""What the transforms expect of a match's raw observation, and how they say so when it differs."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import Transform

from fbrl.envs.observation import OBSERVATION_SPACE

Keys = Sequence[NestedKey] | None
"""Where to find or to write something; None for the usual names."""

FIELD_SHAPES: dict[str, tuple[int, ...]] = {
    **{key: space.shape or () for key, space in OBSERVATION_SPACE.items()},
    "action_memory": (3,),
}
"""Shape of each raw field of one match, after the batch dimensions; and of ``ActionMemory``'s."""

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

    def __init__(self, in_keys: Keys = None, out_keys: Keys = None) -> None:
        super().__init__(
            in_keys=list(self.fields) if in_keys is None else in_keys,
            out_keys=[self.out_key] if out_keys is None else out_keys,
        )
        check_keys(self, self.fields, [self.out_key])

    @abstractmethod
    def compute(self, *fields: Any) -> Tensor:
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
        entry = self._call(zeros_of(observation_spec, self.in_keys)).get(self.out_keys[0])
        kind = Binary if entry.dtype == torch.bool else Unbounded
        observation_spec[self.out_keys[0]] = kind(
            shape=entry.shape, dtype=entry.dtype, device=observation_spec.device
        )
        return observation_spec


def check_keys(transform: Transform, fields: Sequence[str], entries: Sequence[str]) -> None:
    """Raises a ValueError unless a transform has a key for each field and each entry it writes."""
    for argument, keys, names in (
        ("in_keys", transform.in_keys, fields),
        ("out_keys", transform.out_keys, entries),
    ):
        if len(keys) != len(names):
            raise ValueError(
                f"{type(transform).__name__}: {argument} must name {len(names)} keys for "
                f"{tuple(names)}, in this order; got {keys}."
            )


def zeros_of(observation_spec: Composite, keys: Sequence[NestedKey]) -> TensorDict:
    """An observation of zeros, with those of the keys that the spec has."""
    present = observation_spec.keys(True, True)
    zeros = TensorDict(batch_size=observation_spec.shape, device=observation_spec.device)
    for key in keys:
        if key in present:
            zeros.set(key, observation_spec[key].zero())
    return zeros


def read_fields(
    tensordict: TensorDictBase, keys: Sequence[NestedKey], fields: Sequence[str], reader: str
) -> list[Tensor]:
    """Reads the raw fields of these names, which are found at these keys.

    Raises:
        KeyError: a key is missing; the message names the reader.
        ValueError, TypeError: see :func:`checked_field`.
    """
    if not isinstance(tensordict, TensorDictBase):
        raise TypeError(f"{reader} was given a {type(tensordict).__name__}; expected a TensorDict.")
    batch = tensordict.batch_size
    tensors = []
    for key, field in zip(keys, fields, strict=True):
        tensor = tensordict.get(key, None)
        if tensor is None:
            present = sorted(str(k) for k in tensordict.keys(True, True))
            raise KeyError(
                f"{reader}: {key!r} is missing from the tensordict, which has {present}. Use an "
                "environment that gives the raw match observation, such as fbrl.envs.FootballEnv, "
                f"keep {key!r} in the tensordict, or name the key that holds {field!r} in in_keys."
            )
        tensors.append(checked_field(tensor, field, batch, key, reader))
    return tensors


def checked_field(
    tensor: Tensor, field: str, batch: torch.Size, key: NestedKey, reader: str
) -> Tensor:
    """A raw field of a batch of matches, without a trailing dimension of size 1.

    Raises:
        ValueError: it has another shape than the batch's and the field's.
        TypeError: it is not floating point, or not an integer where the field is none.
    """
    expected = (*batch, *FIELD_SHAPES.get(field, ()))
    if tensor.shape != expected:
        # TorchRL's GymWrapper gives the scalars of a single environment a dimension of one.
        if len(expected) != len(batch) or tensor.shape != (*batch, 1):
            raise ValueError(
                f"{reader}: {key!r} has shape {tuple(tensor.shape)}, but a batch of shape "
                f"{tuple(batch)} needs {expected}. Teams of fewer than 11 players are padded with "
                "-1 to 11."
            )
        tensor = tensor.squeeze(-1)
    dtype, is_float = tensor.dtype, field in FLOAT_FIELDS
    if dtype.is_floating_point != is_float or dtype.is_complex or dtype == torch.bool:
        kind = "floating point, such as torch.float32" if is_float else "an integer, as torch.int64"
        raise TypeError(
            f"{reader}: {key!r} has dtype {dtype}, but must be {kind}. Convert it with "
            f"{'.float()' if is_float else '.long()'}."
        )
    return tensor
