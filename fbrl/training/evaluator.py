"""Fresh matches of the policy that is being trained, and pictures of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torchrl.envs import EnvBase

from fbrl.assembly import make_agent_env, make_agent_observation
from fbrl.config import TrainConfig
from fbrl.evaluation.evaluation import Evaluation, evaluate
from fbrl.evaluation.possession import POSSESSION_KEYS, BallPositions
from fbrl.models.actor_critic import ActorCritic
from fbrl.monitor import BALL_POSITIONS, MATCH_VIDEO
from fbrl.run_seeds import other_seed, seed_after_crashes
from fbrl.training.pictures import MatchPictures
from fbrl.transforms import ScoringReward
from fbrl.watch.recording import record_matches
from fbrl.watch.video import missing_video_packages

NUM_PLACES = 4
"""Fresh matches at a time. An engine takes 70 to 130 MB; the same number on every machine, since
the matches depend on it."""


@dataclass(frozen=True)
class EvaluationReport:
    """What came out of fresh matches.

    Attributes:
        evaluation: The results.
        seconds: Time that it took, pictures included.
        images: Pictures by their names in TensorBoard: PNG and GIF files.
    """

    evaluation: Evaluation
    seconds: float
    images: Mapping[str, bytes]


class Evaluator:
    """Plays fresh matches beside a training, without disturbing it.

    The matches are played in an environment of their own, which is made when it is first needed,
    so that those of the training stay where they are; PyTorch's random numbers are left as they
    were. Every evaluation begins the same matches, which are none of the training's: what differs
    between two evaluations is the policy. After a crash they are others, lest they end in it again.

    Args:
        config: The training.
        reward: The training's reward transform; here a copy of it is used.
        on_warning: Called with one line if pictures can't be made.
        crashes: After which the training has gone on.
    """

    def __init__(
        self,
        config: TrainConfig,
        reward: ScoringReward,
        on_warning: Callable[[str], None],
        crashes: int = 0,
    ) -> None:
        self._config = config
        self._reward = reward
        self._on_warning = on_warning
        self._seed = other_seed(seed_after_crashes(config.seed, crashes))
        self._env: EnvBase | None = None
        self._pictures: MatchPictures | None = None
        if config.eval_pictures and config.eval_episodes:
            missing = missing_video_packages()
            if missing:
                on_warning(
                    f"The evaluations go without pictures: {', '.join(missing)} not installed. "
                    "Run pip install 'fbrl[analysis]', or ask for none: eval_pictures=False, "
                    "--no-eval-pictures on a command line."
                )
            else:
                self._pictures = MatchPictures(reward)

    def close(self) -> None:
        """Hands the engines on."""
        if self._env is not None:
            self._env.close()

    def play(
        self, model: ActorCritic, episodes: int, on_progress: Callable[[int], None]
    ) -> EvaluationReport:
        """Plays matches with the policy's sampled actions.

        Args:
            model: Its policy plays.
            episodes: How many matches at least, as for :func:`fbrl.evaluation.evaluation.evaluate`.
            on_progress: Called with the number of matches finished so far.
        """
        device = next(model.parameters()).device
        positions = BallPositions()
        started = time.perf_counter()
        with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
            torch.manual_seed(self._seed)
            env = self._make_env()
            env.set_seed(self._seed)
            evaluation = evaluate(
                env,
                model.get_collection_policy(),
                episodes,
                device=device,
                on_progress=on_progress,
                on_step=positions,
            )
        images = self._draw(model, positions.array())
        return EvaluationReport(evaluation, time.perf_counter() - started, images)

    def _make_env(self) -> EnvBase:
        if self._env is None:
            self._env = make_agent_env(
                self._config,
                num_envs=min(NUM_PLACES, self._config.ppo.num_envs),
                reward=self._reward.clone(),
                num_threads=self._config.num_threads,
                keep_keys=POSSESSION_KEYS,
            )
        return self._env

    def _draw(self, model: ActorCritic, positions: NDArray[np.float64]) -> dict[str, bytes]:
        if self._pictures is None:
            return {}
        (match,) = record_matches(
            model.get_collection_policy(),
            self._config.scenario,
            observation=make_agent_observation(self._config),
            reward=self._reward.clone(),
            episodes=1,
            seed=self._seed,
            device=next(model.parameters()).device,
        )
        try:
            return {
                BALL_POSITIONS: self._pictures.positions(positions),
                MATCH_VIDEO: self._pictures.film(match),
            }
        except Exception as error:  # whatever may be wrong with what draws, a training goes on
            self._pictures = None
            self._on_warning(
                f"The evaluations go on without pictures ({type(error).__name__}: {error})."
            )
            return {}
