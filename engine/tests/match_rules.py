"""The rules that gfootball's Python environment adds to its engine, for controlled players.

Written after gfootball's ``env/football_env_core.py``, apart from fbrl's own, which are compared
with it: forced actions while the game waits, the ends of an episode, the reward.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from any_engine import AnyEngine
from episodes import Episode


class Rules(NamedTuple):
    """What a scenario says of an episode's end."""

    on_score: bool = False
    on_out_of_play: bool = False
    on_possession_change: bool = False
    duration: int = 0


class Memory(NamedTuple):
    """What the rules remember between steps, which the engine's state does not hold."""

    score_difference: int = 0
    game_mode: int = -1
    ball_owned_team: int = -1
    waiting: int = 0


class MatchRules:
    """Steps an engine by the rules.

    Args:
        loaded: The engine's modules.
        game: A started ``GameEnv``.
        see: Called with what the engine tells after each of its steps.

    Attributes:
        sticky_actions: The engine's actions that last until they are released.
        scenario_rules: Those of the episode.
        end: What ended the episode; empty while it goes on.
        action_was_forced: Whether the last actions were others than asked for.
        agents: The controlled players: whether of the left team, and which.
    """

    def __init__(self, loaded: AnyEngine, game: Any, see: Callable[[Any], None]) -> None:
        self._loaded = loaded
        self._game = game
        self._see = see
        actions = loaded.action_set
        self._actions = [action._backend_action for action in actions.action_set_v2]
        self.sticky_actions = [
            action._backend_action for action in actions.action_set_v1 if action._sticky
        ]
        self.scenario_rules = Rules()
        self.end = ""
        self.action_was_forced = False
        self.agents: list[tuple[bool, int]] = []

    def reset(self, episode: Episode) -> None:
        """Starts an episode and steps on until the game is in play."""
        self._game.state = self._loaded.engine.GameState.game_running
        self._game.reset(self._loaded.scenario(episode), False)
        config = self._game.config
        self.scenario_rules = Rules(
            config.end_episode_on_score,
            config.end_episode_on_out_of_play,
            config.end_episode_on_possession_change,
            config.game_duration,
        )
        self._memory = Memory()
        self.end = ""
        self.agents = [(True, player) for player in range(config.left_agents)]
        self.agents += [(False, player) for player in range(config.right_agents)]
        while not self._read().is_in_play:
            self._game.step()

    def step(self, actions: Iterator[int]) -> tuple[int, str]:
        """Plays 100 ms and on until the game is in play.

        Args:
            actions: As many are taken as players are controlled.

        Returns:
            The reward, and what ended the episode.
        """
        for is_left, player in self.agents:
            self._game.perform_action(
                self._permitted(next(actions), is_left, player), is_left, player
            )
        self._game.step()
        while not self._read().is_in_play:
            self._game.step()
        info, before = self._info, self._memory
        mode = int(info.game_mode)
        owner = info.ball_owned_team
        difference = info.left_goals - info.right_goals
        self.end = self._reason_to_end(mode)
        waiting = self._game.waiting_for_game_count + 1 if mode else 0
        self._game.waiting_for_game_count = waiting
        self._memory = Memory(
            difference, mode, before.ball_owned_team if owner == -1 else owner, waiting
        )
        return difference - before.score_difference, self.end

    def memory(self) -> Memory:
        """To be remembered together with the engine's state."""
        return self._memory

    def remember(self, memory: Memory) -> None:
        """Goes on from a memory, once the engine has got the state that belongs to it."""
        self._memory = memory
        self._game.waiting_for_game_count = memory.waiting
        self.end = ""
        self._read()

    def _read(self) -> Any:
        # The engine answers for whichever match this thread stepped last.
        self._info = self._game.get_info()
        self._see(self._info)
        return self._info

    def _permitted(self, action: int, is_left: bool, player: int) -> Any:
        waiting = self._memory.waiting
        self.action_was_forced = waiting >= 20
        actions = self._loaded.engine.e_BackendAction
        if waiting < 20:
            return self._actions[action]
        if waiting == 20:
            return actions.short_pass
        info = self._info
        controllers = info.left_controllers if is_left else info.right_controllers
        if (
            info.ball_owned_team == (0 if is_left else 1)
            and controllers[player].controlled_player == info.ball_owned_player
        ):
            return actions.right if (waiting < 30) == is_left else actions.left
        return actions.idle

    def _reason_to_end(self, mode: int) -> str:
        info, rules, before = self._info, self.scenario_rules, self._memory
        if rules.on_score and info.left_goals + info.right_goals > 0:
            return "score"
        if rules.on_out_of_play and mode != 0 and before.game_mode == 0:
            return "out_of_play"
        if (
            rules.on_possession_change
            and info.ball_owned_team != -1
            and before.ball_owned_team != -1
            and info.ball_owned_team != before.ball_owned_team
        ):
            return "possession"
        return "time_limit" if info.step >= rules.duration else ""
