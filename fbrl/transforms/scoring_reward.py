"""The scoring reward alone, and what every reward made of parts shares: its keys and specs."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

if TYPE_CHECKING:
    from fbrl.density import AssistDensity


class ScoringReward(Transform):
    """Keep the environment's reward as it is, and name it: ``reward_scoring`` equals ``reward``.

    The plain member of a family, in which ``reward_scoring`` is a part of every reward. All entries
    lie under ``"next"`` and have the shape (..., 1). The parts are in the reward spec, as
    :class:`~torchrl.envs.RewardSum` requires, which must come after this transform and be given its
    ``in_keys``. With more than one reward entry, ``env.reward_key`` raises in TorchRL: use
    ``env.reward_keys`` and ``env.full_reward_spec``.

    Called as a module, or as a replay buffer's transform, it relabels stored transitions.

    Args:
        keys: other names for the entries that the transform reads and writes, by their usual name:
            ``{"reward": ("agents", "reward")}``.

    Raises:
        ValueError: if one of them is not an entry of this transform.
        TypeError: if a name is neither a text nor a tuple.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from fbrl.transforms import ScoringReward
        >>> stored = TensorDict({"next": {"reward": torch.ones(2, 1)}}, [2])
        >>> ScoringReward()(stored)["next", "reward_scoring"].squeeze(-1)
        tensor([1., 1.])
    """

    density: AssistDensity | None
    """The densities that it pays for; None where it has none. They are kept with a run and drawn
    with its matches."""

    _keys: dict[str, NestedKey]

    def __init__(self, *, keys: Mapping[str, NestedKey] | None = None) -> None:
        self._set_keys((), (), keys)

    def _set_keys(
        self,
        reads: Sequence[str],
        writes: Sequence[str],
        keys: Mapping[str, NestedKey | None] | None,
        optional: Collection[str] = (),
    ) -> None:
        names = ["reward", "reward_scoring", "done", "terminated", *reads, *writes]
        if keys is not None and not isinstance(keys, Mapping):
            raise TypeError(f"keys is {keys!r}; expected a dictionary of new names by usual ones.")
        given = dict(keys or {})
        for name, key in given.items():
            if not isinstance(key, (str, tuple, type(None))):
                raise TypeError(f"keys renames {name!r} to {key!r}; expected a text or a tuple.")
        unknown = [name for name in given if name not in names]
        if unknown:
            raise ValueError(
                f"keys renames {unknown}, which {type(self).__name__} neither reads nor writes; "
                f"it knows {names}."
            )
        needed = [name for name, key in given.items() if key is None and name not in optional]
        if needed:
            raise ValueError(
                f"keys says None for {needed}, which {type(self).__name__} cannot do without; "
                f"the environment may lack {list(optional) or 'nothing'}."
            )
        resolved = {
            name: unravel_key(key) for name in names if (key := given.get(name, name)) is not None
        }
        super().__init__(
            in_keys=[resolved[name] for name in ("reward", *reads) if name in resolved],
            out_keys=[resolved[name] for name in ("reward", "reward_scoring", *writes)],
        )
        self._keys = resolved
        self.density = None

    @property
    def part_names(self) -> tuple[str, ...]:
        """The usual names of the parts that ``reward`` is the sum of."""
        return ("reward_scoring",)

    def _get(self, tensordict: TensorDictBase, name: str, where: str = "'next'") -> Tensor:
        value = tensordict.get(self._keys[name], None)
        if value is None:
            raise KeyError(
                f"{type(self).__name__} found no {self._keys[name]!r} in {where}. If the entry has "
                f"another name there, pass keys={{{name!r}: <its key>}}."
            )
        return value

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        scoring = self._get(next_tensordict, "reward")
        return next_tensordict.set(self._keys["reward_scoring"], scoring.clone())

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Relabel stored transitions of any batch shape; doing it twice changes nothing."""
        following = self._following(tensordict)
        scoring = self._stored_scoring(following)
        following.set(self._keys["reward"], scoring)
        following.set(self._keys["reward_scoring"], scoring.clone())
        return tensordict

    @property
    def memory_keys(self) -> tuple[NestedKey, ...]:
        """What :meth:`label` needs from what came before: nothing, without a memory."""
        return ()

    def begin(self, state: TensorDictBase) -> None:
        """Sets the memory of episodes that begin with these observations, if there is one."""

    def label(self, batch: TensorDictBase, start: TensorDictBase, end: TensorDictBase) -> None:
        """Writes what stepping through a whole batch with this transform would have written.

        All steps at once take a fraction of the time that they take one by one.

        Args:
            batch: ordered steps of several environments, shape (num_envs, num_steps), with the
                observation at their root and under ``"next"``.
            start: what the first steps went on from, shape (num_envs,): what the previous call
                left in ``end``, or :meth:`begin` prepared.
            end: what the last steps led to, after the resets; it is given the memory.
        """
        self.forward(batch)

    def _following(self, tensordict: TensorDictBase) -> TensorDictBase:
        if not isinstance(tensordict, TensorDictBase):
            kind = type(tensordict).__name__
            raise TypeError(f"{type(self).__name__} was given a {kind}; expected a TensorDict.")
        following = tensordict.get("next", None)
        if not isinstance(following, TensorDictBase):
            raise KeyError(
                f"{type(self).__name__} relabels transitions, but this tensordict has no 'next' "
                f"entry (its keys: {sorted(map(str, tensordict.keys()))}). Inside an environment, "
                "use TransformedEnv instead of calling the transform."
            )
        return following

    def _stored_scoring(self, following: TensorDictBase) -> Tensor:
        # `reward` may already contain shaping; the scoring part, once written, never does.
        scoring = following.get(self._keys["reward_scoring"], None)
        return self._get(following, "reward") if scoring is None else scoring

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        """Add the parts, and lift the bounds of ``reward``, which shaping may exceed."""
        reward_key, scoring_key = self._keys["reward"], self._keys["reward_scoring"]
        present = reward_spec.keys(True, True)
        if reward_key not in present:
            raise KeyError(
                f"{type(self).__name__} found no reward {reward_key!r} in the environment, which "
                f"has {list(present)}. Pass keys={{'reward': <its key>}}."
            )
        if scoring_key in present:
            raise ValueError(
                f"The environment already has a {scoring_key!r}: another reward of this family "
                f"wrote it. Use one of them, or give this {type(self).__name__} another name for "
                "it with keys={'reward_scoring': <a new key>}."
            )
        scoring_spec = reward_spec[reward_key].clone()
        reward_spec[scoring_key] = scoring_spec
        shape, device = scoring_spec.shape, scoring_spec.device
        parts = [name for name in self.part_names if name != "reward_scoring"]
        for name in parts:
            reward_spec[self._keys[name]] = Unbounded(shape, dtype=torch.float32, device=device)
        if parts:
            dtype = torch.promote_types(scoring_spec.dtype, torch.float32)
            reward_spec[reward_key] = Unbounded(shape, dtype=dtype, device=device)
        return reward_spec
