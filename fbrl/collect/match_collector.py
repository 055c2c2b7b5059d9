"""Collects batches from matches that the engine's threads step, at the engine's speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import Transform, TransformedEnv

from fbrl.checks import check_count, check_memory
from fbrl.collect.collector import (
    BatchCollector,
    EpisodeBookkeeping,
    inference_threads,
    torch_threads,
)
from fbrl.envs.arguments import check_seed
from fbrl.envs.factory import FootballMatches, make_observation, make_reward, raw_keys_of
from fbrl.envs.matches import RESULTS, MatchState, MidwayStarts, empty_arrays
from fbrl.envs.observation import Observation
from fbrl.envs.vector_env import FootballVectorEnv
from fbrl.models.actor_critic import CollectionPolicy
from fbrl.transforms import PlayStatistics, ScoringReward

_MATCHES_FOR_THREE_GROUPS = 48


class _Group(NamedTuple):
    """Matches that are stepped together, while the policy looks at those of another group."""

    rows: slice
    """Their numbers, and rows in the batch."""
    views: list[TensorDict]
    """For each step, and the one after the last, what the policy's observation is made of, and the
    observation itself: views of the batch, shape (matches,)."""


class MatchCollector(BatchCollector):
    """Plays matches in threads of this process and writes what happens where the batch lies.

    Between two steps of a match only its observation is computed and its action chosen. Whatever
    no action depends on, the reward among it, is worked out for the whole batch at its end.

    The matches are in fixed groups, which take turns: while the threads step one of them, the
    policy looks at another. The batch is the same, however many there are, but for the last bits
    of what a network computes for fewer matches at a time.

    Args:
        scenario: As for :func:`fbrl.envs.make_env`, like all that is not named here.
        policy: Chooses the actions, on the device where it is.
        num_steps: Steps of each match in a batch.
        num_groups: Groups that take turns. By default two, from 48 matches on three, with which
            many cores wait least.
        midway_starts: Share of the matches that begin in states of earlier ones, see
            :class:`~fbrl.envs.matches.MidwayStarts`. Batches then have ``begun_midway`` under
            ``"next"``, bool (num_envs, num_steps).

    Raises:
        ValueError: A name is unknown, or a number out of range.
        EngineNotInstalledError: gfootball is missing.

    Examples:
        >>> from fbrl.models.actor_critic import build_actor_critic
        >>> policy = build_actor_critic("simple115").get_collection_policy()
        >>> collector = MatchCollector("academy_empty_goal", policy, num_envs=2, num_steps=16)
        >>> collector.collect()["next", "reward"].shape
        torch.Size([2, 16, 1])
    """

    def __init__(
        self,
        scenario: str,
        policy: CollectionPolicy,
        *,
        num_envs: int = 8,
        num_steps: int = 128,
        reward: str | ScoringReward = "analytics",
        observation: str | Transform = "simple115",
        num_threads: int | None = None,
        frame_skip: int = 1,
        num_groups: int | None = None,
        midway_starts: float = 0.0,
        seed: int | None = None,
    ) -> None:
        self.policy = policy
        self._num_steps = check_count("num_steps", num_steps)
        if num_groups is not None:
            check_count("num_groups", num_groups)
        reward = make_reward(reward)
        self._transform = transform = make_observation(observation)
        self._raw_keys = keys = sorted(raw_keys_of([transform, reward, PlayStatistics()]))
        self._bookkeeping = EpisodeBookkeeping(reward)
        self._matches = FootballVectorEnv(
            scenario, num_envs, num_threads, keys, frame_skip=frame_skip
        )
        matches = FootballMatches(self._matches, categorical_action_encoding=True, device="cpu")
        # Kept, since it closes the matches when it goes.
        self._env = TransformedEnv(matches, transform)
        specs = self._env.observation_spec.items(True, True)
        self._observed = {key: spec for key, spec in specs if key not in keys}
        self._state: TensorDict | None = None
        self._noise: list[Tensor] = []
        self._midway_starts = MidwayStarts(midway_starts) if midway_starts else None
        self._begun_midway = torch.zeros((num_envs, num_steps), dtype=torch.bool)
        self._lay_out(num_envs, num_groups)
        if seed is not None:
            self.set_seed(seed)

    def _lay_out(self, num_envs: int, num_groups: int | None) -> None:
        """Makes the batch, and what writes to each step of it."""
        steps, keys = self._num_steps, self._raw_keys
        space = self._matches.single_observation_space

        def columns(length: int) -> dict[str, Tensor]:
            arrays = empty_arrays(space, num_envs, length)
            observed = {
                key: torch.zeros((num_envs, length, *spec.shape[1:]), dtype=spec.dtype)
                for key, spec in self._observed.items()
            }
            return {key: torch.from_numpy(array) for key, array in arrays.items()} | observed

        self._end = columns(1)
        what = f"A batch of {num_envs} matches (num_envs) and {steps} steps (num_steps)"
        size = 2 * steps * sum(column.nbytes for column in self._end.values())
        check_memory(what, size, "Make one of them smaller.")
        self._root, self._next = columns(steps), columns(steps)
        for name in RESULTS:
            del self._root[name], self._end[name]
        self._flags = [self._next[name].numpy() for name in ("terminated", "truncated")]
        self._action = torch.zeros((num_envs, steps), dtype=torch.int64)
        self._log_prob = torch.zeros((num_envs, steps), device=self.policy.device)
        self._value = torch.zeros((num_envs, steps, 1), device=self.policy.device)

        def rows(columns: Mapping[str, Tensor], names: Sequence[str], step: int) -> Any:
            return self._matches.make_rows({name: columns[name].numpy()[:, step] for name in names})

        self._rows = [rows(self._next, [*keys, *RESULTS], step) for step in range(steps)]
        self._next_rows = [rows(self._root, keys, step) for step in range(1, steps)]
        self._next_rows.append(rows(self._end, keys, 0))
        num_groups = num_groups or (2 if num_envs < _MATCHES_FOR_THREE_GROUPS else 3)
        shares = torch.arange(num_envs).tensor_split(min(num_groups, num_envs))
        self._groups = [self._make_group(int(share[0]), int(share[-1]) + 1) for share in shares]

    def _make_group(self, first: int, end: int) -> _Group:
        rows = slice(first, end)

        def view(columns: Mapping[str, Tensor], step: int) -> TensorDict:
            values = {key: column[rows, step] for key, column in columns.items()}
            return TensorDict(values, [end - first])

        steps = {**self._root, "action": self._action}
        views = [view(steps, step) for step in range(self._num_steps)]
        return _Group(rows, [*views, view(self._end, 0)])

    def set_seed(self, seed: int) -> None:
        """See :meth:`BatchCollector.set_seed`."""
        self._env.set_seed(check_seed(seed))

    @torch.no_grad()
    def reset(self) -> None:
        """See :meth:`BatchCollector.reset`."""
        observation, _ = self._matches.reset()
        self._state = self._begun(observation)

    @torch.no_grad()
    def collect(self) -> TensorDictBase:
        """See :meth:`BatchCollector.collect`.

        A batch that is broken off leaves no trace but in the matches and the random numbers.
        """
        if self._state is None:
            self.reset()
        start = self._state
        assert start is not None
        for group in self._groups:
            for key, column in self._root.items():
                column[group.rows, 0] = group.views[0][key] = start.get(key)[group.rows]
        with torch_threads(inference_threads(self.policy)):
            self._noise.clear()
            playing = [self._send(group, 0) for group in self._groups]
            for step in range(self._num_steps):
                for number, group in enumerate(self._groups):
                    playing[number].wait()
                    self._look(group, step)
                    if step + 1 < self._num_steps:
                        playing[number] = self._send(group, step + 1)
        return self._complete(start)

    def _send(self, group: _Group, step: int) -> Any:
        """Chooses the actions of a group, and has its matches play them."""
        if len(self._noise) == step:
            self._noise.append(self.policy.draw_noise(self._matches.num_envs))
        observation, *masks = (group.views[step].get(key) for key in self.policy.in_keys)
        noise = self._noise[step][group.rows]
        action, log_prob, value = self.policy.act(observation, noise, *masks)
        self._action[group.rows, step] = action
        self._log_prob[group.rows, step] = log_prob
        self._value[group.rows, step] = value
        return self._matches.send_step(
            range(group.rows.start, group.rows.stop),
            action.tolist(),
            self._rows[step],
            self._next_rows[step],
        )

    def _look(self, group: _Group, step: int) -> None:
        """Computes what the policy looks at after a step."""
        before, after = group.views[step], group.views[step + 1]
        self._transform._step(before, after)
        if self._midway_starts is not None:
            begun_midway = self._matches.begun_midway[group.rows]
            self._begun_midway[group.rows, step] = torch.from_numpy(begun_midway)
        done = np.logical_or(*(flag[group.rows, step] for flag in self._flags))
        if done.any():
            self._matches.begun_anew((group.rows.start + np.flatnonzero(done)).tolist())
            kept = after.copy().set("_reset", torch.from_numpy(done).unsqueeze(-1))
            self._transform._reset(kept, after)
        columns = self._root if step + 1 < self._num_steps else self._end
        for key in self._observed:
            columns[key][group.rows, (step + 1) % self._num_steps] = after.get(key)

    def _complete(self, start: TensorDict) -> TensorDictBase:
        """The batch, and what the next one begins with."""
        results = {name: self._next[name].unsqueeze(-1) for name in RESULTS}
        results["done"] = results["terminated"] | results["truncated"]
        self._observe_last_states(results["done"].squeeze(-1))
        batch = TensorDict(
            {
                **self._root,
                "action": self._action,
                "action_log_prob": self._log_prob.cpu(),
                "state_value": self._value.cpu(),
                "next": {**self._next, **results},
            },
            self._action.shape,
            device="cpu",
        )
        last = {key: column[:, 0].clone() for key, column in self._end.items()}
        end = TensorDict(last, batch.shape[:1])
        self._bookkeeping.complete(batch, start, end)
        self._state = end
        if self._midway_starts is not None:
            batch["next", "begun_midway"] = self._begun_midway
            self._midway_starts.keep(self._matches.match_states())
            self._matches.begin_from(self._midway_starts.choose)
        return batch.exclude(*self._raw_keys, *(("next", key) for key in self._raw_keys))

    def _observe_last_states(self, done: Tensor) -> None:
        """Writes what would have been observed of the states that steps led to.

        Where an episode goes on, it is what the next action was chosen by.
        """
        ends = done.nonzero(as_tuple=True)
        steps = {**self._root, "action": self._action}
        before, after = (
            TensorDict({key: column[ends] for key, column in columns.items()}, ends[0].shape)
            for columns in (steps, self._next)
        )
        self._transform._step(before, after)
        for key in self._observed:
            self._next[key][:, :-1] = self._root[key][:, 1:]
            self._next[key][:, -1] = self._end[key][:, 0]
            self._next[key][ends] = after.get(key)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`BatchCollector.state_dict`; after a reset the first time."""
        if self._state is None:
            self.reset()
        assert self._state is not None
        carried = self._state.select(*self._observed, *self._bookkeeping.keys)
        kept = () if self._midway_starts is None else self._midway_starts.kept()
        return {
            "matches": self._matches.get_state(),
            "kept_states": [{"match": asdict(state)} for state in kept],
            "next_step": carried.to_dict(),
        }

    @torch.no_grad()
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`BatchCollector.load_state_dict`."""
        begun = self._begun(self._matches.set_state(state["matches"]))
        for key in (*self._observed, *self._bookkeeping.keys):
            entry, expected = state["next_step"][key], begun.get(key)
            if entry.shape != expected.shape or entry.dtype != expected.dtype:
                raise ValueError(f"{key} is {entry.dtype} of shape {tuple(entry.shape)}")
            begun.set(key, entry)
        self._state = begun
        if self._midway_starts is not None:
            self._midway_starts.keep(MatchState(**kept["match"]) for kept in state["kept_states"])
            self._matches.begin_from(self._midway_starts.choose)

    def _begun(self, observation: Observation) -> TensorDict:
        """What episodes go on from that begin with this observation."""
        raw = {key: torch.from_numpy(array) for key, array in observation.items()}
        state = TensorDict(raw, [self._matches.num_envs])
        self._transform._reset(TensorDict(batch_size=state.batch_size), state)
        self._bookkeeping.begin(state)
        return state

    def disturb(self, disturbance: Any) -> None:
        """See :meth:`fbrl.envs.FootballVectorEnv.disturb`."""
        self._matches.disturb(disturbance)

    def close(self) -> None:
        """See :meth:`BatchCollector.close`."""
        self._matches.close()
