"""Many football matches as one Gymnasium environment, stepped by the engine's threads."""

from __future__ import annotations

import copy
import dataclasses
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from fbrl.checks import check_count, check_memory, check_name
from fbrl.envs import arguments
from fbrl.envs.engine import NUM_ACTIONS
from fbrl.envs.matches import RESULTS, Matches, MatchState, stating_what_is_no_match
from fbrl.envs.observation import Observation, select_space
from fbrl.envs.rendering import (
    DRAWN_KEYS,
    RENDER_METADATA,
    check_render_mode,
    draw_from_above,
    render_metadata,
)
from fbrl.scenarios import LARGEST_FRAME_SKIP, check_scenario

ActionSet = Literal["default", "v2"]
"""Gfootball's names: 19 actions, or these and :data:`~fbrl.envs.engine.BUILTIN_AI`."""

BYTES_PER_MATCH = 2**20
"""At least; those of 11 against 11 take up to 6 MB."""

_ACTIONS_IN_SET = {"default": NUM_ACTIONS, "v2": NUM_ACTIONS + 1}


class FootballVectorEnv(VectorEnv[Observation, np.ndarray, np.ndarray]):
    """Several independent matches of one scenario, stepped by the engine's threads.

    These hold no Python lock, so that they are as parallel as processes. Match i plays exactly what
    a :class:`FootballEnv` with the same seed and actions plays.

    Args:
        scenario: As for :class:`FootballEnv`, like ``observation_keys``.
        num_envs: Number of matches.
        num_threads: Threads that step them; by default one for each available core, at most
            ``num_envs``.
        observation_keys: What is observed.
        action_set: ``"default"`` (19 actions), or ``"v2"`` with the engine's own player as a 20th.
        render_mode: As for :class:`FootballEnv`; the matches are seen from above.
        frame_skip: As for :class:`FootballEnv`.

    Attributes:
        begun_midway: Which matches are in an episode that began in a state of an earlier one, see
            :meth:`begin_from`; bool (num_envs,).

    Raises:
        ValueError: ``num_envs`` or ``num_threads`` is not positive, ``frame_skip`` not in
            [1, 100], or a name is unknown.
        TypeError: One of these is no integer, or the keys are no list of names.
        EngineNotInstalledError: gfootball is missing.
        MissingExtraError: Packages that pictures need are missing.

    Matches do not start again by themselves (``AutoresetMode.DISABLED``): after an episode's
    end, call ``reset(options={"reset_mask": mask})``. TorchRL's ``GymWrapper`` does so. With
    any other mode TorchRL would lose the last state of each episode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (the base class's type)
        **RENDER_METADATA,
        "autoreset_mode": AutoresetMode.DISABLED,
    }

    def __init__(
        self,
        scenario: str,
        num_envs: int = 1,
        num_threads: int | None = None,
        observation_keys: Iterable[str] | None = None,
        action_set: ActionSet = "default",
        *,
        render_mode: str | None = None,
        frame_skip: int = 1,
    ) -> None:
        num_envs = check_count("num_envs", num_envs)
        if num_threads is not None:
            num_threads = check_count("num_threads", num_threads)
        what = f"num_envs is {num_envs}: so many matches"
        check_memory(what, num_envs * BYTES_PER_MATCH, "Ask for fewer.")
        self.scenario = check_scenario(scenario)
        self.num_envs = num_envs
        # TorchRL's GymWrapper asks the instance, not its metadata.
        self.autoreset_mode = AutoresetMode.DISABLED
        self.frame_skip = check_count("frame_skip", frame_skip, at_most=LARGEST_FRAME_SKIP)
        self.metadata = self.metadata | render_metadata(self.frame_skip)
        self.single_observation_space: spaces.Dict = select_space(observation_keys)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._num_actions = _ACTIONS_IN_SET[check_name("action_set", action_set, _ACTIONS_IN_SET)]
        self.single_action_space = spaces.Discrete(self._num_actions)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.num_threads = min(num_envs, num_threads or len(os.sched_getaffinity(0)))
        self.render_mode = check_render_mode(render_mode)
        keys, drawn_keys = self.single_observation_space, DRAWN_KEYS if render_mode else ()
        self._matches = Matches(
            scenario, num_envs, self.num_threads, keys, drawn_keys, self.frame_skip
        )
        self._episodes = [arguments.EpisodeSeeds() for _ in range(num_envs)]
        self.begun_midway = np.zeros(num_envs, bool)
        # What each match begins at its end, while the others are still stepped: the seeds of the
        # episode, and whether it begins midway.
        self._next: list[tuple[arguments.EpisodeSeeds, bool] | None] = [None] * num_envs
        self._choose_start: Callable[[int], MatchState | None] = lambda engine_seed: None

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode in all matches, or in those of a mask.

        Args:
            seed: One integer, from which an independent seed for each match is spawned; or a
                seed for each match, which are then its engine seeds.
            options: ``{"reset_mask": mask}`` with a boolean array of shape (num_envs,) resets
                only the matches where it is true; the others are observed as they stand.

        Raises:
            ValueError: A seed is out of range, a length is another, or there are other options.
        """
        self._check_open()
        given = arguments.check_options(options, ("reset_mask",))
        mask = arguments.check_mask(given.get("reset_mask"), self.num_envs)
        seeds = arguments.spread_seed(seed, self.num_envs)
        chosen = np.flatnonzero(mask).tolist()
        for index in chosen:
            if seeds[index] is None and self._next[index]:
                self._go_on(index)
            else:
                episode = self._episodes[index]
                episode.advance(seeds[index])
                self._matches.prepare(index, episode.engine_seed, episode.number)
                self.begun_midway[index] = False
        self._matches.begin(chosen)
        for index in chosen:
            self._prepare_next(index)
        return self._matches.observe(), self._info()

    @property
    def episodes(self) -> list[tuple[int, int]]:
        """Engine seed and number of each match's episode, which decide all but the actions."""
        return list(self._matches.episodes)

    def step(
        self, actions: np.ndarray
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Plays one step in every match.

        Raises:
            ValueError: The actions are not integers in [0, 18] (19 with action set v2) of shape
                (num_envs,).
            RuntimeError: A match has not begun or has ended, or the environment is closed.
        """
        self._check_open()
        actions = arguments.check_actions(actions, self.num_envs, self._num_actions)
        self._check_running("step()")
        self._matches.step(range(self.num_envs), actions.tolist())
        results = [self._matches.arrays[key].copy() for key in RESULTS]
        return self._matches.observe(), *results, self._info()

    def make_rows(self, arrays: Mapping[str, np.ndarray]) -> Any:
        """Arrays for :meth:`send_step` to write to, checked once.

        They are named by observation keys, ``reward``, ``terminated`` or ``truncated``, and of
        shape (num_envs, ...), the first axis with any stride.
        """
        return self._matches.make_rows(arrays)

    def send_step(
        self, matches: Sequence[int], actions: Sequence[int], rows: Any, next_rows: Any
    ) -> Any:
        """Has some matches play a step, and on into their next episode where theirs ends.

        Nothing is checked in Python, and other matches can be sent meanwhile.

        Args:
            matches: Their numbers; none of them is being played.
            actions: One of each.
            rows: What the step leads to, from :meth:`make_rows`.
            next_rows: What the next step begins with, likewise.

        Returns:
            What to ``wait()`` for; then :meth:`begun_anew` is to be told whose episodes ended.
        """
        return self._matches.native.send_step(matches, actions, rows, next_rows)

    def begun_anew(self, matches: Iterable[int]) -> None:
        """Notes which matches have begun their next episodes in :meth:`send_step`."""
        for index in matches:
            self._go_on(index)
            self._matches.begun_anew([index])
            self._prepare_next(index)

    def begin_from(self, choose_start: Callable[[int], MatchState | None]) -> None:
        """Says where episodes begin from now on, but for those that are given a seed.

        Args:
            choose_start: Given the engine seed with which an episode would begin, returns a state
                of an earlier episode of this scenario in which it is to begin, or None.

        Raises:
            RuntimeError: A match has not begun or has ended.
        """
        self._check_running("begin_from()")
        self._choose_start = choose_start
        for index in range(self.num_envs):
            self._prepare_next(index)

    def match_states(self) -> list[MatchState]:
        """The state of each match, which has to be running.

        Raises:
            RuntimeError: A match has not begun or has ended.
        """
        self._check_running("match_states()")
        return [self._matches.get_state(index) for index in range(self.num_envs)]

    def disturb(self, disturbance: Any) -> None:
        """Puts something in the place of steps: the engine's ``Disturbance``, or None to end it."""
        self._matches.native.disturb(disturbance)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Draws each match as :meth:`FootballEnv.render` does; ``None`` without a render mode."""
        if self.render_mode is None:
            return None
        arrays = self._matches.arrays
        return tuple(
            draw_from_above(self.scenario, {key: arrays[key][index] for key in DRAWN_KEYS})
            for index in range(self.num_envs)
        )

    def get_state(self) -> list[dict[str, Any]]:
        """The state of each match, which has to be running, and of its next episodes' seeds.

        Numbers, strings and bytes; 30 to 80 KB for each match.

        Raises:
            RuntimeError: A match has not begun or has ended.
        """
        self._check_running("get_state()")
        return [
            {
                "match": dataclasses.asdict(self._matches.get_state(index)),
                "episodes": self._episodes[index].get_state(),
                "begun_midway": bool(self.begun_midway[index]),
            }
            for index in range(self.num_envs)
        ]

    def set_state(self, states: Sequence[Mapping[str, Any]]) -> Observation:
        """Goes on from a state: all matches, and those after them, then replay exactly.

        Args:
            states: Of as many matches of this scenario, from a source that is trusted: see
                :meth:`fbrl.envs.matches.Matches.prepare_state`.

        Raises:
            ValueError: They are not, as far as can be seen.
        """
        if not isinstance(states, Sequence) or len(states) != self.num_envs:
            number = len(states) if isinstance(states, Sequence) else repr(states)
            raise ValueError(f"There are states of {number} matches for {self.num_envs} matches.")
        for index, state in enumerate(states):
            with stating_what_is_no_match(f"State {index}"):
                self._matches.set_state(index, MatchState(**state["match"]))
                self._episodes[index].set_state(state["episodes"])
                # Before there were any, nothing was said of it.
                self.begun_midway[index] = state.get("begun_midway", False)
                self._prepare_next(index)
        return self._matches.observe()

    def __deepcopy__(self, memo: dict[int, Any]) -> FootballVectorEnv:
        """Refuses: engines and threads can't be copied."""
        raise TypeError(
            "A FootballVectorEnv can't be copied. Make another one, and have it go on from this "
            "one's get_state() with set_state()."
        )

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the threads and hands the engines on to the next matches of this process."""
        self._matches.close()

    def _info(self) -> dict[str, np.ndarray]:
        # Gymnasium's mask says that all are told.
        seeds = np.array([seed for seed, _ in self._matches.episodes], np.int64)
        return {"engine_seed": seeds, "_engine_seed": np.ones(self.num_envs, bool)}

    def _check_open(self) -> None:
        if self.closed:
            raise RuntimeError(f"The matches of {self.scenario!r} are closed: make new ones.")

    def _check_running(self, call: str) -> None:
        self._check_open()
        if ended := self._matches.not_running():
            raise RuntimeError(
                f"Matches {ended} of {self.scenario!r} have not begun or have ended: call "
                f"reset(options={{'reset_mask': mask}}) for them before {call}."
            )

    def _go_on(self, index: int) -> None:
        """Goes on to the episode that is prepared."""
        prepared = self._next[index]
        assert prepared is not None
        self._episodes[index], self.begun_midway[index] = prepared

    def _prepare_next(self, index: int) -> None:
        episode = copy.deepcopy(self._episodes[index])
        episode.advance()
        start = self._choose_start(episode.engine_seed)
        if start is None:
            self._matches.prepare(index, episode.engine_seed, episode.number)
        else:
            self._matches.prepare_state(index, start)
        self._next[index] = episode, start is not None
