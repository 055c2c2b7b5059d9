"""One match of the gfootball engine: raw numbers in, raw numbers out.

Drives ``gfootball_engine.GameEnv`` directly and repeats the rules of gfootball's
``env/football_env_core.py`` (forced actions while the game waits, the ends of an episode, the
score reward), so that a match here agrees step for step with one played through gfootball's own
Python environment.
"""

from __future__ import annotations

import threading
import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np

from fbrl.checks.field_types import check_field_types
from fbrl.envs.gfootball_import import GFootball, load_gfootball
from fbrl.envs.match_row import WHOLE_ROW, RowLayout

NUM_ACTIONS = 19
BUILTIN_AI = NUM_ACTIONS
"""One more action, which lets the engine's own player decide; gfootball's action set v2 ends so."""

MAX_SEED = 2**32 - 1
"""The engine's seed is a C++ ``unsigned int``."""

FIRST_EPISODE = 2
"""Number of an environment's first episode, as in gfootball; left kicks off in even ones."""

ROW_LENGTH = WHOLE_ROW.length
"""Numbers of a match with all its keys."""

# Behind the random numbers the engine's state has the scenario's rules and the seed, which its
# GameContext::ProcessState checks too, but by crashing. It writes at most ten million bytes.
_CONSTANT_PART = slice(2512, 2580)
_LARGEST_STATE = 10_000_000

# gfootball restarts a match for a player who makes it wait: football_env_core.py, step().
_WAITING_STEPS_BEFORE_FORCED_PASS = 20
_WAITING_STEPS_BEFORE_TURNING_BACK = 30


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


def _leave(engine: Any) -> None:
    """Does nothing with an engine that somebody else looks after."""


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
        seed: Engine seed that the episode began with.
        episode_number: Its number.
        engine: The engine's own state, its random numbers included; 30 to 80 KB.
        waiting_steps: Steps since the game stopped, which the forced actions depend on.
        previous_score_difference: Goals for minus goals against after the last step.
        previous_game_mode: Its game mode; -1 before the first step.
        previous_ball_owned_team: The team that had the ball last; -1 if none had.
    """

    seed: int
    episode_number: int
    engine: bytes
    waiting_steps: int
    previous_score_difference: int
    previous_game_mode: int
    previous_ball_owned_team: int


class Match:
    """A match in which one player of the left team at a time is controlled.

    Args:
        scenario: Name of a scenario module in ``gfootball.scenarios``.
        engine: A started engine to play it in, which stays the caller's; by default one that no
            other match uses.

    Raises:
        EngineNotInstalledError: gfootball can't be imported.

    A match may be stepped from any thread, by one thread at a time: the engine releases the
    GIL while it computes, so that several matches run in parallel threads of one process.
    """

    def __init__(self, scenario: str, engine: Any = None) -> None:
        self.scenario = scenario
        self._gfootball = load_gfootball()
        actions = self._gfootball.action_set
        self._backend_actions = [a._backend_action for a in actions.action_set_v2]
        self._sticky_actions = [a._backend_action for a in actions.action_set_v1 if a._sticky]
        self._engine = engine or _acquire_engine(self._gfootball)
        release = _idle_engines.append if engine is None else _leave
        self._release = weakref.finalize(self, release, self._engine)
        self._normal_mode = int(self._gfootball.engine.e_GameMode.e_GameMode_Normal)
        self._running = False

    def close(self) -> None:
        """Hands the engine on to the next match; the match can't be used any more."""
        self._running = False
        self._release()

    def _check_open(self) -> None:
        if not self._release.alive:
            raise RuntimeError(f"The match of {self.scenario!r} is closed: make a new one.")

    def reset(self, seed: int, episode_number: int = FIRST_EPISODE) -> None:
        """Starts an episode and steps on until the game is in play.

        Args:
            seed: Engine seed in [0, 2**32 - 1]; its parity decides which team the engine
                processes first. Scenarios marked deterministic ignore it.
            episode_number: In scenarios with a kick-off the left team has it in even episodes.
        """
        self._check_open()
        self._previous_score_difference = 0
        self._previous_game_mode = -1
        self._previous_ball_owned_team = -1
        self._episode = seed, episode_number
        self._engine.state = self._gfootball.engine.GameState.game_running
        self._engine.reset(build_scenario(self.scenario, seed, episode_number), False)
        config = self._engine.config
        self._ends_on_score = config.end_episode_on_score
        self._ends_on_out_of_play = config.end_episode_on_out_of_play
        self._ends_on_possession_change = config.end_episode_on_possession_change
        self._duration = config.game_duration
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

        truncated = not terminated and info.step >= self._duration
        self._running = not (terminated or truncated)
        return StepResult(reward, terminated, truncated)

    def get_state(self) -> MatchState:
        """The state of a running episode.

        Raises:
            RuntimeError: The episode has not begun or has ended.
        """
        self._check_running("get_state()")
        return MatchState(
            *self._episode,
            self._engine.get_state(""),
            self._engine.waiting_for_game_count,
            self._previous_score_difference,
            self._previous_game_mode,
            self._previous_ball_owned_team,
        )

    def set_state(self, state: MatchState) -> None:
        """Goes on from a state; the match then replays exactly, whatever was played since.

        Args:
            state: Of a match of this scenario. The engine takes it as it is: one that was tampered
                with can do to the process whatever it wants.

        Raises:
            ValueError: It is not the state of such a match, as far as can be seen.
            TypeError: A value in it is of another type.
        """
        check_field_types(state)
        # Which team is processed first, and who kicks off, is no part of the engine's state.
        self.reset(state.seed, state.episode_number)
        self._check_engine_state(state.engine)
        self._engine.set_state(state.engine)
        self._engine.waiting_for_game_count = state.waiting_steps
        self._previous_score_difference = state.previous_score_difference
        self._previous_game_mode = state.previous_game_mode
        self._previous_ball_owned_team = state.previous_ball_owned_team
        self._read_info()

    def _check_engine_state(self, state: bytes) -> None:
        # The engine answers what it can't read by crashing the process.
        fresh = self._engine.get_state("")
        if not isinstance(state, bytes) or len(state) < _CONSTANT_PART.stop:
            raise ValueError(f"The engine's state is {state!r:.40}; it must be that of a match.")
        if len(state) > _LARGEST_STATE or state[_CONSTANT_PART] != fresh[_CONSTANT_PART]:
            raise ValueError(
                f"The engine's state is not that of a match of {self.scenario!r} with seed "
                f"{self._episode[0]}."
            )

    def _check_running(self, call: str) -> None:
        if not self._running:
            self._check_open()
            raise RuntimeError(
                f"The match of {self.scenario!r} is not running: call reset() before {call}, also "
                "after an episode's end."
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
        info = self._info
        if self._ends_on_score and (info.left_goals > 0 or info.right_goals > 0):
            return True
        if (
            self._ends_on_out_of_play
            and game_mode != self._normal_mode
            and self._previous_game_mode == self._normal_mode
        ):
            return True
        return (
            self._ends_on_possession_change
            and info.ball_owned_team != -1
            and self._previous_ball_owned_team != -1
            and info.ball_owned_team != self._previous_ball_owned_team
        )

    def read(self, row: np.ndarray, layout: RowLayout = WHOLE_ROW) -> None:
        """Writes the state of the match into a row that the caller owns.

        Args:
            row: Array of ``layout.length`` numbers.
            layout: What to read, and where in the row to write it.
        """
        layout.read(row, self._engine, self._info, self._sticky_actions, self._duration)
