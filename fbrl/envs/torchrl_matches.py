"""The vector environment as a TorchRL environment."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Unbounded
from torchrl.envs import GymWrapper

from fbrl.envs.vector_env import FootballVectorEnv


class FootballMatches(GymWrapper):
    """TorchRL's wrapper of a :class:`~fbrl.envs.FootballVectorEnv`, with a step of its own.

    The arrays of a step have the dtypes and the shapes that the specs promise and belong to the
    caller already, so the tensors share their memory. ``GymWrapper`` looks up and encodes each
    entry, which at 8 matches takes several times as long.

    Takes the arguments of ``GymWrapper``.

    Examples:
        >>> from fbrl.envs import FootballVectorEnv
        >>> matches = FootballVectorEnv("academy_empty_goal", num_envs=2)
        >>> env = FootballMatches(matches, categorical_action_encoding=True, device="cpu")
        >>> env.rollout(3)["next", "ball"].shape
        torch.Size([2, 3, 3])
    """

    @property
    def matches(self) -> FootballVectorEnv:
        """The vector environment that is wrapped."""
        return self._env

    def _make_specs(self, *args: Any, **kwargs: Any) -> None:
        super()._make_specs(*args, **kwargs)
        # Whatever PyTorch's default is, rewards are what the matches write.
        shape = (*self.batch_size, 1)
        self.reward_spec = Unbounded(shape, dtype=torch.float32, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict.get("action", None)
        if action is None:
            raise KeyError(
                "There is no 'action' in the tensordict that is stepped, which has "
                f"{sorted(map(str, tensordict.keys()))}. A policy writes it, or "
                "env.rand_action(tensordict)."
            )
        observation, reward, terminated, truncated, info = self._env.step(action.numpy())
        arrays = {
            **observation,
            "reward": reward[:, None],
            "terminated": terminated[:, None],
            "truncated": truncated[:, None],
            "done": (terminated | truncated)[:, None],
        }
        following = TensorDict(
            {key: torch.from_numpy(array) for key, array in arrays.items()},
            batch_size=self.batch_size,
            device=self.device,
        )
        for read in self.info_dict_reader:
            following = read(info, following)
        return following
