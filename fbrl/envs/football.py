"""A football match as a Gymnasium environment."""

from __future__ import annotations

import copy
import dataclasses
import sys
from collections.abc import Iterable, Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from fbrl.checks import check_count
from fbrl.envs.arguments import check_options, check_seed, draw_seed
from fbrl.envs.engine import FIRST_EPISODE, NUM_ACTIONS
from fbrl.envs.matches import RESULTS, Matches, MatchState, stating_what_is_no_match
from fbrl.envs.observation import Observation, select_space, without_scalars
from fbrl.envs.rendering import (
    DRAWN_KEYS,
    RENDER_METADATA,
    EpisodeInEngine,
    View,
    check_render_mode,
    draw_from_above,
    render_metadata,
)
from fbrl.scenarios import LARGEST_FRAME_SKIP, check_scenario


class FootballEnv(gymnasium.Env[Observation, np.int64]):
    """One match in which the agent plays the controlled player of the left team.

    Also made by ``gymnasium.make("fbrl/<scenario>-v0")`` once :mod:`fbrl` is imported.

    Args:
        scenario: A name in :data:`fbrl.envs.SCENARIOS`, or of one's own scenario module.
        observation_keys: Keys to observe, all by default: fewer are faster. See
            :mod:`fbrl.envs.observation` for their meaning.
        render_mode: ``"rgb_array"`` for pictures by :meth:`render`.
        view: What they show: the match from above (``"2d"``), or as the engine itself draws it
            (``"3d"``), which needs the package fbrl-engine-render.
        frame_skip: Steps of gfootball in each step. The action is played in the first of them, as
            a button is pressed once; what was held before, or is held by it, stays held.

    Raises:
        ValueError: An observation key, the scenario, the render mode or the view is unknown, or
            ``frame_skip`` is not in [1, 100].
        EngineNotInstalledError: gfootball is missing.
        MissingExtraError: Packages that pictures need are missing.

    The action is an index into gfootball's default action set of 19; a step plays 100 ms, or
    ``frame_skip`` times as much. The reward is the change of the goal difference. ``terminated``
    says that a rule of the scenario ended the episode, ``truncated`` that its time limit did.

    ``reset(seed=s)`` starts an episode whose engine seed is exactly ``s``, with the left team
    to kick off; later resets draw fresh engine seeds from the environment's ``np_random`` and
    alternate the kick-off. ``info["engine_seed"]`` names the episode's seed. Python's
    global random state is neither read nor changed.

    Examples:
        >>> env = FootballEnv("academy_empty_goal_close")
        >>> observation, info = env.reset(seed=1)
        >>> observation, reward, terminated, truncated, info = env.step(5)
        >>> observation["ball"].shape
        (3,)

        A video of each episode::

            env = gymnasium.make("fbrl/academy_corner-v0", render_mode="rgb_array")
            env = gymnasium.wrappers.RecordVideo(env, "videos", lambda episode: True)
    """

    metadata = RENDER_METADATA

    def __init__(
        self,
        scenario: str,
        observation_keys: Iterable[str] | None = None,
        *,
        render_mode: str | None = None,
        view: View = "2d",
        frame_skip: int = 1,
    ) -> None:
        self.scenario = check_scenario(scenario)
        _refuse_next_step_autoreset(scenario)
        self.frame_skip = check_count("frame_skip", frame_skip, at_most=LARGEST_FRAME_SKIP)
        self.metadata = render_metadata(self.frame_skip)
        self.render_mode = check_render_mode(render_mode, view)
        self.observation_space: spaces.Dict = without_scalars(select_space(observation_keys))
        self.action_space = spaces.Discrete(NUM_ACTIONS)
        drawn_keys = DRAWN_KEYS if self.render_mode else ()
        self._matches = Matches(scenario, 1, 1, self.observation_space, drawn_keys, self.frame_skip)
        self._in_engine = (
            EpisodeInEngine(scenario, self.frame_skip) if render_mode and view == "3d" else None
        )
        self._episode_number = FIRST_EPISODE - 1

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; ``seed`` is in [0, 2**32 - 1], and there are no options.

        Raises:
            ValueError: The seed is out of range, or there are options.
        """
        check_options(options, ())
        engine_seed = None if seed is None else check_seed(seed)
        super().reset(seed=engine_seed)
        if engine_seed is None:
            engine_seed = draw_seed(self.np_random)
            self._episode_number += 1
        else:
            self._episode_number = FIRST_EPISODE
        self._matches.prepare(0, engine_seed, self._episode_number)
        self._matches.begin([0])
        if self._in_engine:
            self._in_engine.begin(engine_seed, self._episode_number)
        return self._observe(), self._info()

    def step(
        self, action: int | np.integer[Any]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Plays one step.

        Raises:
            ValueError: The action is not in [0, 18].
            RuntimeError: The episode has not begun or has ended, or the environment is closed.
        """
        if not self.action_space.contains(action) or isinstance(action, bool):
            raise ValueError(f"Action {action!r} is not an integer in [0, {NUM_ACTIONS - 1}].")
        if self._matches.not_running():
            raise RuntimeError(
                f"The match of {self.scenario!r} is not running: call reset() before step(), also "
                "after an episode's end."
            )
        self._matches.step([0], [int(action)])
        if self._in_engine:
            self._in_engine.step(int(action))
        reward, terminated, truncated = (self._matches.arrays[key].item() for key in RESULTS)
        return self._observe(), reward, terminated, truncated, self._info()

    def _info(self) -> dict[str, np.int64]:
        return {"engine_seed": np.int64(self._matches.episodes[0][0])}

    def _observe(self) -> Observation:
        shapes = {key: box.shape for key, box in self.observation_space.items()}
        return {key: array.reshape(shapes[key]) for key, array in self._matches.observe().items()}

    def get_state(self) -> dict[str, Any]:
        """The state of the running match, and of what the next ones begin with.

        Numbers, strings and bytes; 30 to 80 KB.

        Raises:
            RuntimeError: The episode has not begun or has ended, or the environment is closed.
        """
        return {
            "match": dataclasses.asdict(self._matches.get_state(0)),
            "episode_number": self._episode_number,
            "np_random": self.np_random.bit_generator.state,
        }

    def set_state(self, state: Mapping[str, Any]) -> Observation:
        """Goes on from a state: the match, and those after it, then replay exactly.

        Args:
            state: Of a match of this scenario, from a source that is trusted: see
                :meth:`fbrl.envs.matches.Matches.prepare_state`.

        Raises:
            ValueError: It is not, as far as can be seen.
            RuntimeError: The match is drawn by the engine (view 3d), which can only follow it from
                its beginning.
        """
        if self._in_engine:
            raise RuntimeError("A match with view='3d' can't go on from a state: take view='2d'.")
        with stating_what_is_no_match("The state"):
            self._matches.set_state(0, MatchState(**state["match"]))
            self._episode_number = int(state["episode_number"])
            self.np_random.bit_generator.state = state["np_random"]
        return self._observe()

    def __deepcopy__(self, memo: dict[int, Any]) -> FootballEnv:
        """Another match that goes on as this one would, to look ahead say."""
        other = type(self)(
            self.scenario,
            list(self.observation_space),
            render_mode=self.render_mode,
            view="3d" if self._in_engine else "2d",
            frame_skip=self.frame_skip,
        )
        other.spec = self.spec
        other.np_random = copy.deepcopy(self.np_random)
        other._episode_number = self._episode_number
        if not self._matches.not_running():
            other.set_state(self.get_state())
        return other

    def render(self) -> np.ndarray | None:
        """Draws the last state; after an episode's end that is the one that ended it.

        Returns:
            Red, green and blue, uint8 (height, width, 3); ``None`` without a render mode.

        Raises:
            RenderingError: The engine can't draw (view 3d).
        """
        if self.render_mode is None:
            return None
        if self._in_engine:
            return self._in_engine.draw()
        arrays = self._matches.arrays
        return draw_from_above(self.scenario, {key: arrays[key][0] for key in DRAWN_KEYS})

    def close(self) -> None:
        """Hands the engine on to the next match of this process."""
        self._matches.close()
        if self._in_engine:
            self._in_engine.close()


def _refuse_next_step_autoreset(scenario: str) -> None:
    """Refuses ``torchrl.envs.GymEnv(..., num_envs=N)``, in which data would be wrong silently.

    It takes Gymnasium's default mode, which begins an episode in the step after the last one; its
    own ``GymWrapper`` refuses that. Nothing but the caller tells.
    """
    frame = sys._getframe()
    while frame.f_back is not None:
        frame = frame.f_back
        name = frame.f_code.co_name, frame.f_globals.get("__name__")
        if name == ("_async_env", "torchrl.envs.libs.gym"):
            raise ValueError(
                "GymEnv(..., num_envs=N) would lose the last state of each episode. Use "
                f"fbrl.envs.make_env({scenario!r}, num_envs=N), or "
                f"GymWrapper(FootballVectorEnv({scenario!r}, N), categorical_action_encoding=True)."
            )
