"""One match of the gfootball engine: raw numbers in, raw numbers out.

The only module that imports gfootball. It drives ``gfootball_engine.GameEnv`` directly and
repeats the rules of gfootball's ``env/football_env_core.py`` (forced actions while the game
waits, the ends of an episode, the score reward), so that a match here agrees step for step
with one played through gfootball's own Python environment.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import sys
import threading
import types
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

NUM_ACTIONS = 19
BUILTIN_AI = NUM_ACTIONS
"""One more action, which lets the engine's own player decide; gfootball's action set v2 ends so."""

MAX_PLAYERS = 11
MAX_SEED = 2**32 - 1
"""The engine's seed is a C++ ``unsigned int``."""

FIRST_EPISODE = 2
"""Number of an environment's first episode, as in gfootball; left kicks off in even ones."""

PADDING = -1
"""Fills positions, directions and roles of the players that a small-sided scenario lacks."""

PLAYER_FIELDS = {
    "position": 2,
    "direction": 2,
    "tired_factor": 1,
    "yellow_card": 1,
    "active": 1,
    "role": 1,
}
"""How many numbers each property of a player takes in a row, in their order."""

MATCH_FIELDS = {
    "ball": 3,
    "ball_direction": 3,
    "ball_rotation": 3,
    "active": 1,
    "designated": 1,
    "ball_owned_team": 1,
    "ball_owned_player": 1,
    "game_mode": 1,
    "score": 2,
    "steps_left": 1,
    "sticky_actions": 10,
}
"""The same for the properties of the match, which follow the players of both teams."""

_TEAM_LENGTH = MAX_PLAYERS * sum(PLAYER_FIELDS.values())
ROW_LENGTH = 2 * _TEAM_LENGTH + sum(MATCH_FIELDS.values())

# gfootball restarts a match for a player who makes it wait: football_env_core.py, step().
_WAITING_STEPS_BEFORE_FORCED_PASS = 20
_WAITING_STEPS_BEFORE_TURNING_BACK = 30

_INSTALL_REMEDY = (
    "Run `make setup` in a clone of fbrl, which builds it with everything that it needs; "
    "`fbrl-doctor` checks the result."
)


class EngineNotInstalledError(ImportError):
    """Raised where a match is asked for and gfootball can't be imported."""


@dataclass(frozen=True)
class GFootball:
    """The parts of gfootball in use: its compiled engine and three of its Python modules."""

    engine: types.ModuleType
    config: types.ModuleType
    scenario_builder: types.ModuleType
    action_set: types.ModuleType


def _gym_stand_in() -> dict[str, types.ModuleType]:
    """Modules that gfootball finds under the name of gym, which is neither needed nor wanted."""
    gym = types.ModuleType("gym")
    for name in ("Env", "Wrapper", "ObservationWrapper", "RewardWrapper", "spaces"):
        setattr(gym, name, getattr(gymnasium, name))
    envs = types.ModuleType("gym.envs")
    registration = types.ModuleType("gym.envs.registration")
    # gfootball would otherwise put ids that can't be made into Gymnasium's registry.
    vars(registration)["register"] = lambda **_: None
    vars(gym)["envs"], vars(envs)["registration"] = envs, registration
    return {
        "gym": gym,
        "gym.spaces": gymnasium.spaces,
        "gym.envs": envs,
        "gym.envs.registration": registration,
    }


@contextlib.contextmanager
def _modules_replaced(replacements: Mapping[str, types.ModuleType]) -> Iterator[None]:
    before = {name: sys.modules.get(name) for name in replacements}
    sys.modules.update(replacements)
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


@functools.cache
def load_gfootball() -> GFootball:
    """Imports gfootball without gym: no banner, nothing registered, no pygame window.

    Raises:
        EngineNotInstalledError: gfootball, or something that it imports, is missing.
    """
    try:
        with _modules_replaced(_gym_stand_in()):
            return GFootball(
                engine=importlib.import_module("gfootball_engine"),
                config=importlib.import_module("gfootball.env.config"),
                scenario_builder=importlib.import_module("gfootball.env.scenario_builder"),
                action_set=importlib.import_module("gfootball.env.football_action_set"),
            )
    except ImportError as error:
        raise EngineNotInstalledError(
            f"The football engine can't be imported ({error}). {_INSTALL_REMEDY}"
        ) from error


def build_scenario(scenario: str, seed: int, episode_number: int) -> Any:
    """Builds the configuration of one episode, to be handed to the engine once.

    The engine scales the ball's position in place, so each episode needs a new one.
    """
    config = load_gfootball().config.Config(
        {
            "level": scenario,
            "game_engine_random_seed": seed,
            # gfootball adds one before it builds the scenario.
            "episode_number": episode_number - 1,
        }
    )
    return config.ScenarioConfig()


# An engine keeps 70 to 130 MB that are never freed, so finished matches hand theirs on.
_idle_engines: list[Any] = []
# The first start of an engine sets up process-wide state in SDL and the file system layer.
_engine_lock = threading.Lock()


def _acquire_engine(gfootball: GFootball) -> Any:
    with _engine_lock:
        if _idle_engines:
            return _idle_engines.pop()
        engine = gfootball.engine.GameEnv()
        engine.start_game()
        return engine


@dataclass(frozen=True)
class StepResult:
    """What a step led to.

    Attributes:
        reward: Change of the goal difference, in {-1, 0, 1}.
        terminated: A rule of the scenario ended the episode (goal, ball out, possession lost).
        truncated: The time limit was reached and no rule ended the episode.
    """

    reward: int
    terminated: bool
    truncated: bool


@dataclass(frozen=True)
class MatchState:
    """Everything that decides how a match goes on.

    Attributes:
        engine: The engine's own state, its random numbers included; 30 to 80 KB.
        waiting_steps: Steps since the game stopped, which the forced actions depend on.
        previous_score_difference: Goals for minus goals against after the last step.
        previous_game_mode: Its game mode; -1 before the first step.
        previous_ball_owned_team: The team that had the ball last; -1 if none had.
    """

    engine: bytes
    waiting_steps: int
    previous_score_difference: int
    previous_game_mode: int
    previous_ball_owned_team: int


class Match:
    """A match in which one player of the left team at a time is controlled.

    Args:
        scenario: Name of a scenario module in ``gfootball.scenarios``.

    Raises:
        EngineNotInstalledError: gfootball can't be imported.

    A match may be stepped from any thread, by one thread at a time: the engine releases the
    GIL while it computes, so that several matches run in parallel threads of one process.
    """

    def __init__(self, scenario: str) -> None:
        self.scenario = scenario
        self._gfootball = load_gfootball()
        actions = self._gfootball.action_set
        self._backend_actions = [a._backend_action for a in actions.action_set_v2]
        self._sticky_actions = [a._backend_action for a in actions.action_set_v1 if a._sticky]
        self._engine = _acquire_engine(self._gfootball)
        self._release = weakref.finalize(self, _idle_engines.append, self._engine)
        self._normal_mode = int(self._gfootball.engine.e_GameMode.e_GameMode_Normal)
        self._running = False

    def close(self) -> None:
        """Hands the engine on to the next match; the match can't be used any more."""
        self._running = False
        self._release()

    def reset(self, seed: int, episode_number: int = FIRST_EPISODE) -> None:
        """Starts an episode and steps on until the game is in play.

        Args:
            seed: Engine seed in [0, 2**32 - 1]; its parity decides which team the engine
                processes first. Scenarios marked deterministic ignore it.
            episode_number: In scenarios with a kick-off the left team has it in even episodes.
        """
        if not self._release.alive:
            raise RuntimeError(f"The match of {self.scenario!r} is closed: make a new one.")
        self._previous_score_difference = 0
        self._previous_game_mode = -1
        self._previous_ball_owned_team = -1
        self._engine.state = self._gfootball.engine.GameState.game_running
        self._engine.reset(build_scenario(self.scenario, seed, episode_number), False)
        self._read_info()
        while not self._info.is_in_play:
            self._step_engine()
        self._running = True

    def step(self, action: int) -> StepResult:
        """Plays 100 ms (ten physics steps), and on until the game is in play.

        Args:
            action: Index into gfootball's default action set, in [0, 18], or :data:`BUILTIN_AI`.

        Raises:
            RuntimeError: The episode has not begun or has ended.
        """
        self._check_running("step()")
        self._engine.perform_action(self._permitted_action(action), True, 0)
        self._step_engine()
        while not self._info.is_in_play:
            self._step_engine()

        info = self._info
        game_mode = int(info.game_mode)
        terminated = self._episode_ended_by_rule(game_mode)
        score_difference = info.left_goals - info.right_goals
        reward = score_difference - self._previous_score_difference

        self._previous_score_difference = score_difference
        self._previous_game_mode = game_mode
        if info.ball_owned_team != -1:
            self._previous_ball_owned_team = info.ball_owned_team
        if game_mode == self._normal_mode:
            self._engine.waiting_for_game_count = 0
        else:
            self._engine.waiting_for_game_count += 1

        truncated = not terminated and info.step >= self._engine.config.game_duration
        self._running = not (terminated or truncated)
        return StepResult(reward, terminated, truncated)

    def get_state(self) -> MatchState:
        """The state of a running episode.

        Raises:
            RuntimeError: The episode has not begun or has ended.
        """
        self._check_running("get_state()")
        return MatchState(
            self._engine.get_state(""),
            self._engine.waiting_for_game_count,
            self._previous_score_difference,
            self._previous_game_mode,
            self._previous_ball_owned_team,
        )

    def set_state(self, state: MatchState) -> None:
        """Goes on from a state; the match then replays exactly, whatever was played since.

        Args:
            state: Of a match of this scenario.

        Raises:
            RuntimeError: No episode is running, of which the engine could take the line-ups.
        """
        self._check_running("set_state()")
        self._engine.set_state(state.engine)
        self._engine.waiting_for_game_count = state.waiting_steps
        self._previous_score_difference = state.previous_score_difference
        self._previous_game_mode = state.previous_game_mode
        self._previous_ball_owned_team = state.previous_ball_owned_team
        self._read_info()

    def _check_running(self, call: str) -> None:
        if not self._running:
            raise RuntimeError(
                f"The match of {self.scenario!r} is not running: call reset() before the first "
                f"{call} and after an episode's end."
            )

    def _step_engine(self) -> None:
        self._engine.step()
        self._read_info()

    def _read_info(self) -> None:
        # get_info() reads the engine that this thread used last, whatever `self` is: it may
        # only follow a call of this engine on the same thread.
        self._info = self._engine.get_info()

    def _permitted_action(self, action: int) -> Any:
        """The action asked for, or the one that gets a waiting game going again."""
        waiting = self._engine.waiting_for_game_count
        if waiting < _WAITING_STEPS_BEFORE_FORCED_PASS:
            return self._backend_actions[action]
        actions = self._gfootball.engine.e_BackendAction
        if waiting == _WAITING_STEPS_BEFORE_FORCED_PASS:
            return actions.short_pass
        info = self._info
        if (
            info.ball_owned_team == 0
            and info.left_controllers[0].controlled_player == info.ball_owned_player
        ):
            turn_back = waiting >= _WAITING_STEPS_BEFORE_TURNING_BACK
            return actions.left if turn_back else actions.right
        return actions.idle

    def _episode_ended_by_rule(self, game_mode: int) -> bool:
        info, config = self._info, self._engine.config
        if config.end_episode_on_score and (info.left_goals > 0 or info.right_goals > 0):
            return True
        if (
            config.end_episode_on_out_of_play
            and game_mode != self._normal_mode
            and self._previous_game_mode == self._normal_mode
        ):
            return True
        return (
            config.end_episode_on_possession_change
            and info.ball_owned_team != -1
            and self._previous_ball_owned_team != -1
            and info.ball_owned_team != self._previous_ball_owned_team
        )

    def read(self, row: np.ndarray) -> None:
        """Writes the state of the match into a row that the caller owns.

        Args:
            row: float64 array of :data:`ROW_LENGTH` numbers: :data:`MAX_PLAYERS` blocks of
                :data:`PLAYER_FIELDS` for each team, then :data:`MATCH_FIELDS`. The blocks of
                players that the scenario lacks are not written.
        """
        info, engine = self._info, self._engine
        left_players, designated = _read_team(info.left_team)
        right_players, _ = _read_team(info.right_team)
        row[: len(left_players)] = left_players
        row[_TEAM_LENGTH : _TEAM_LENGTH + len(right_players)] = right_players
        ball, direction, rotation = info.ball_position, info.ball_direction, info.ball_rotation
        row[2 * _TEAM_LENGTH :] = [
            *(ball[0], ball[1], ball[2]),
            *(direction[0], direction[1], direction[2]),
            *(rotation[0], rotation[1], rotation[2]),
            info.left_controllers[0].controlled_player,
            designated,
            info.ball_owned_team,
            info.ball_owned_player,
            int(info.game_mode),
            info.left_goals,
            info.right_goals,
            engine.config.game_duration - info.step,
            *(engine.sticky_action_state(action, True, 0) for action in self._sticky_actions),
        ]


def _read_team(players: Any) -> tuple[list[float], int]:
    """The players' fields one after the other, and the index of the designated player or -1."""
    values: list[float] = []
    designated = -1
    for index, player in enumerate(players):
        position, direction = player.position, player.direction
        values += (
            position[0],
            position[1],
            direction[0],
            direction[1],
            player.tired_factor,
            player.has_card,
            player.is_active,
            player.role,
        )
        if player.designated_player:
            designated = index
    return values, designated
