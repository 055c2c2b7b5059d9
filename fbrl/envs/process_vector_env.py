"""Matches in several processes of threads, each of which may die without ending the others."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from fbrl.checks.counts import check_count
from fbrl.envs.arguments import check_actions, check_mask, check_options
from fbrl.envs.episode_seeds import spread_seed
from fbrl.envs.match_worker import CallFailedError, MatchWorker, WorkerLostError, WorkerSettings
from fbrl.envs.observation import Observation
from fbrl.envs.vector_env import ActionSet, MatchesVectorEnv

CORES_PER_WORKER = 4
"""Of the default number of workers. One process of threads is as quick on so few cores, and takes
less memory; with more, what its threads do in Python begins to stand in line."""

MAX_RESTARTS = 10
"""Of all workers together, by default."""

_START_TIMEOUT = 120


class MatchWorkersError(RuntimeError):
    """Raised when workers have died, or hung, too often, or one does not begin at all."""


class FootballProcessVectorEnv(MatchesVectorEnv):
    """A :class:`FootballVectorEnv` whose matches are shared out to processes.

    For machines with many cores, where the threads of one process stand in line for Python's
    lock, and for engines that are not trusted: a process that dies or hangs is replaced. Its
    matches are lost: they end, truncated, with the last state that was seen, and others begin.
    Seeds, matches and states are those of :class:`FootballVectorEnv`, bit for bit.

    As everywhere with Python's ``spawn``, the main module of a program that makes one must not
    make it on import: put it below ``if __name__ == "__main__":``.

    Args:
        scenario, num_envs, observation_keys, action_set: As for :class:`FootballVectorEnv`.
        num_threads: Threads of all workers together; by default one for each available core.
        num_workers: Processes; by default one for every :data:`CORES_PER_WORKER` cores, at least
            2, at most ``num_envs``.
        timeout: Seconds after which a worker that does not answer is replaced; 0 for never. Time
            in which this process itself stands still does not count.
        max_restarts: How often workers are replaced, all together, before it is an error; by
            default :data:`MAX_RESTARTS`.
        on_restart: Called with one line about each replacement.

    Attributes:
        lost_matches: Matches that were lost so far.

    Raises:
        ValueError: A number is not positive, or a key is unknown.
        UnknownNameError: There is no such scenario.

    Examples:
        >>> env = FootballProcessVectorEnv("academy_empty_goal", num_envs=2)
        >>> observation, _ = env.reset(seed=1)
        >>> observation["ball"].shape
        (2, 3)
        >>> env.close()
    """

    def __init__(
        self,
        scenario: str,
        num_envs: int = 1,
        num_threads: int | None = None,
        observation_keys: Iterable[str] | None = None,
        action_set: ActionSet = "default",
        *,
        num_workers: int | None = None,
        timeout: float = 20,
        max_restarts: int | None = None,
        on_restart: Callable[[str], None] = lambda line: None,
    ) -> None:
        num_envs = check_count("num_envs", num_envs)
        super().__init__(scenario, num_envs, observation_keys, action_set)
        cores = len(os.sched_getaffinity(0))
        if num_workers is None:
            num_workers = max(2, cores // CORES_PER_WORKER)
        workers = min(check_count("num_workers", num_workers), num_envs)
        threads = cores if num_threads is None else check_count("num_threads", num_threads)
        self._action_set = action_set
        self._num_threads = max(1, threads // workers)
        self._timeout = timeout
        self._restarts_left = MAX_RESTARTS if max_restarts is None else max_restarts
        self._on_restart = on_restart
        self.lost_matches = 0
        self._share = [part.tolist() for part in np.array_split(np.arange(num_envs), workers)]
        self._workers: list[MatchWorker] = []
        # Of the seeds that lost matches are followed by.
        self._random = np.random.default_rng()
        self._observation: Observation = {}
        self._ended = np.zeros(num_envs, bool)
        # Workers that were replaced while no step was played: the next one has to tell.
        self._to_tell: set[int] = set()
        self._is_asking = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode in all matches, or in those of a mask.

        Takes the arguments of :meth:`FootballVectorEnv.reset`.

        Raises:
            ValueError: A seed is out of range, the mask or the seeds have another length, or there
                are other options.
            RuntimeError: The environment is closed.
            MatchWorkersError: Workers were lost too often.
        """
        self._check_open()
        mask = check_mask(check_options(options, ("reset_mask",)).get("reset_mask"), self.num_envs)
        seeds = spread_seed(seed, self.num_envs)
        if isinstance(seed, (int, np.integer)):
            self._random = np.random.default_rng(seed)
        if not self._workers:
            self._workers = [
                self._start(number, [seeds[i] for i in share])
                for number, share in enumerate(self._share)
            ]
            answers = self._begin()
        else:

            def arguments(share: list[int]) -> dict[str, Any]:
                options = {"reset_mask": mask[share]}
                return {"seed": [seeds[i] for i in share], "options": options}

            answers = self._ask("reset", arguments)
            self._to_tell -= {n for n, share in enumerate(self._share) if mask[share].all()}
        self._ended &= ~mask
        observations, infos = zip(*answers, strict=True)
        info = {key: np.concatenate([one[key] for one in infos]) for key in infos[0]}
        before = self._observation
        observation = self._join(observations)
        for number in self._to_tell:
            # The next step tells that these have ended, with what was seen of them.
            lost = [index for index in self._share[number] if not mask[index]]
            for key, value in observation.items():
                value[lost] = before[key][lost]
        return observation, info

    def step(
        self, actions: np.ndarray
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Plays one step in every match; a lost one ends, truncated, as it was last seen.

        Args:
            actions: As for :meth:`FootballVectorEnv.step`.

        Raises:
            ValueError: The actions have another shape, dtype or range.
            RuntimeError: A match has not begun or has ended, or the environment is closed.
            MatchWorkersError: Workers were lost too often.
        """
        self._check_begun("step()")
        actions = check_actions(actions, self.num_envs, self._num_actions)
        self._check_none_ended(np.flatnonzero(self._ended).tolist(), "step()")
        answers = self._ask("step", lambda share: {"actions": actions[share]})
        observations, *results, _ = zip(*answers, strict=True)
        rewards, terminated, truncated = map(np.concatenate, results)
        self._ended = terminated | truncated
        return self._join(observations), rewards, terminated, truncated, {}

    @property
    def episodes(self) -> list[tuple[int, int]]:
        """See :attr:`MatchesVectorEnv.episodes`."""
        self._check_begun("episodes")
        return self._ask_all("episodes")

    @property
    def has_lost_matches(self) -> bool:
        """See :attr:`MatchesVectorEnv.has_lost_matches`; others play in their place already."""
        return bool(self._to_tell)

    def get_state(self) -> list[dict[str, Any]]:
        """See :meth:`MatchesVectorEnv.get_state`."""
        self._check_begun("get_state()")
        self._check_none_ended(np.flatnonzero(self._ended).tolist(), "get_state()")
        return self._ask_all("get_state")

    def set_state(self, states: Sequence[Mapping[str, Any]]) -> None:
        """See :meth:`MatchesVectorEnv.set_state`."""
        self._check_number_of_states(states)
        if not self._workers:
            self.reset()
        self._ask("set_state", lambda share: {"states": [states[i] for i in share]})
        self._to_tell.clear()
        self._ended[:] = False

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the workers."""
        for worker in self._workers:
            worker.end()

    def _begin(self) -> list[Any]:
        """What the matches begin with; a worker that fails now would do so again."""
        answers = []
        for number, worker in enumerate(self._workers):
            try:
                answers.append(self._first_answer(worker))
            except WorkerLostError as error:
                self.close()
                raise MatchWorkersError(
                    f"Worker {number}, which was to play {len(self._share[number])} matches of "
                    f"{self.scenario!r}, {error} before they began: what it wrote to the error "
                    "output says why. A program's main module must make workers below 'if "
                    '__name__ == "__main__":\' only; fbrl-doctor checks the engine.'
                ) from error
        return answers

    def _ask_all(self, method: str) -> list[Any]:
        return [one for answer in self._ask(method, lambda share: {}) for one in answer]

    def _ask(self, method: str, arguments: Callable[[list[int]], dict[str, Any]]) -> list[Any]:
        """Asks all workers at once; one that is lost is replaced.

        Where calls have failed, all others have answered too before the first failure is raised:
        the matches can be used further.

        Args:
            method: Of :class:`FootballVectorEnv`.
            arguments: Of a worker's matches.
        """
        if self._is_asking:
            raise RuntimeError("A call of these matches was broken off: close them, make new ones.")
        self._is_asking = True
        silent = self._to_tell if method == "step" else set()
        for number, share in enumerate(self._share):
            if number not in silent:
                self._workers[number].ask(method, arguments(share))
        answers, failures = [], []
        for number in range(len(self._share)):
            try:
                answers.append(
                    self._cut_off(number)
                    if number in silent
                    else self._answer(number, method, arguments)
                )
            except CallFailedError as error:
                failures.append(error.__cause__)
        self._is_asking = False
        for failure in failures:
            assert failure is not None
            raise failure
        self._to_tell = self._to_tell - silent
        return answers

    def _answer(
        self, number: int, method: str, arguments: Callable[[list[int]], dict[str, Any]]
    ) -> Any:
        while True:
            try:
                return self._workers[number].answer(self._timeout)
            except WorkerLostError as error:
                self._replace(number, str(error))
            if method == "step":
                return self._cut_off(number)
            self._to_tell.add(number)
            self._workers[number].ask(method, arguments(self._share[number]))

    def _cut_off(self, number: int) -> tuple[Any, ...]:
        """What a step led to in the matches of a worker that was lost."""
        share = self._share[number]
        observation = {key: value[share] for key, value in self._observation.items()}
        nothing = np.zeros(len(share), bool)
        return observation, nothing.astype(np.float32), nothing, ~nothing, {}

    def _start(self, number: int, seeds: Sequence[int | None]) -> MatchWorker:
        settings = WorkerSettings(
            self.scenario,
            len(self._share[number]),
            self._num_threads,
            tuple(self.single_observation_space),
            self._action_set,
            self._share[number][0],
            seeds,
        )
        return MatchWorker(f"matches-{number}", settings)

    def _first_answer(self, worker: MatchWorker) -> Any:
        return worker.answer(self._timeout and max(self._timeout, _START_TIMEOUT))

    def _replace(self, number: int, reason: str) -> None:
        share = self._share[number]
        self.lost_matches += len(share)
        while True:
            self._workers[number].end()
            line = (
                f"Worker {number}, which plays {len(share)} matches of {self.scenario!r}, "
                f"{reason}; {self.lost_matches} matches have been lost so far."
            )
            if not self._restarts_left:
                raise MatchWorkersError(f"{line} That was too often.")
            self._restarts_left -= 1
            self._on_restart(f"{line} It is replaced, {self._restarts_left} times more at most.")
            seeds = self._random.integers(2**31, size=len(share)).tolist()
            self._workers[number] = self._start(number, seeds)
            try:
                self._first_answer(self._workers[number])
                return
            except WorkerLostError as error:
                reason = str(error)

    def _join(self, observations: Sequence[Observation]) -> Observation:
        self._observation = {
            key: np.concatenate([one[key] for one in observations]) for key in observations[0]
        }
        return self._observation

    def _check_begun(self, call: str) -> None:
        self._check_open()
        if not self._workers:
            raise RuntimeError(f"The matches have not begun: call reset() before {call}.")
