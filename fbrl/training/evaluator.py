"""Fresh matches of the policy that is being trained, and pictures of them."""

from __future__ import annotations

import io
import itertools
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import torch
from numpy.typing import ArrayLike
from torchrl.envs import EnvBase

from fbrl.assembly import make_agent_env, make_agent_observation
from fbrl.config import TrainConfig
from fbrl.density import AssistDensity
from fbrl.evaluation.evaluation import Evaluation, evaluate
from fbrl.evaluation.possession import POSSESSION_KEYS, BallPositions
from fbrl.models.actor_critic import ActorCritic
from fbrl.monitor import BALL_POSITIONS, MATCH_VIDEO
from fbrl.run_seeds import other_seed, seed_after_crashes
from fbrl.transforms import ScoringReward
from fbrl.watch.recording import MatchRecording, record_matches
from fbrl.watch.video import missing_video_packages

NUM_PLACES = 4
"""Fresh matches at a time. An engine takes 70 to 130 MB; the same number on every machine, since
the matches depend on it."""

_DOTS_PER_INCH = 90
_VIDEO_WIDTH = 480
_SECONDS = 40.0
_SECONDS_PER_PICTURE = 0.2
# Seconds of the match in one of the film.
_SPEED = 2.0


class Evaluator:
    """Plays fresh matches beside a training, without disturbing it.

    The matches are played in an environment of their own, which is made when it is first needed,
    so that those of the training stay where they are; PyTorch's random numbers are left as they
    were. Every evaluation begins the same matches, which are none of the training's: what differs
    between two evaluations is the policy. After a crash they are others, lest they end in it again.
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
        self._has_pictures = config.eval_pictures and config.eval_episodes > 0
        if self._has_pictures and (missing := missing_video_packages()):
            self._has_pictures = False
            on_warning(
                f"The evaluations go without pictures: {', '.join(missing)} not installed. "
                "Run pip install 'fbrl[analysis]', or ask for none: eval_pictures=False, "
                "--no-eval-pictures on a command line."
            )

    def close(self) -> None:
        """Hands the engines on."""
        if self._env is not None:
            self._env.close()

    def play(
        self, model: ActorCritic, episodes: int, on_progress: Callable[[int], None]
    ) -> tuple[Evaluation, Mapping[str, bytes]]:
        """Plays at least so many matches with the policy's sampled actions.

        Returns:
            The results, and pictures by their names in TensorBoard: PNG and GIF files.
        """
        config, policy, positions = self._config, model.get_collection_policy(), BallPositions()
        device = next(model.parameters()).device
        with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
            torch.manual_seed(self._seed)
            if self._env is None:
                self._env = make_agent_env(
                    config,
                    num_envs=min(NUM_PLACES, config.ppo.num_envs),
                    reward=self._reward.clone(),
                    num_threads=config.num_threads,
                    keep_keys=POSSESSION_KEYS,
                )
            env = self._env
            env.set_seed(self._seed)
            evaluation = evaluate(
                env, policy, episodes, device=device, on_progress=on_progress, on_step=positions
            )
        if not self._has_pictures:
            return evaluation, {}
        (match,) = record_matches(
            policy,
            config.scenario,
            observation=make_agent_observation(config),
            reward=self._reward.clone(),
            episodes=1,
            seed=self._seed,
            frame_skip=config.ppo.frame_skip,
            device=device,
        )
        pictures = MatchPictures(self._reward)
        try:
            return evaluation, {
                BALL_POSITIONS: pictures.positions(positions.array()),
                MATCH_VIDEO: pictures.film(match),
            }
        except Exception as error:  # whatever may be wrong with what draws, a training goes on
            self._has_pictures = False
            self._on_warning(
                f"The evaluations go on without pictures ({type(error).__name__}: {error})."
            )
            return evaluation, {}


class MatchPictures:
    """Draws where an agent has the ball, and films its matches, with the densities of its reward.

    Where it has none, those that fbrl ships stand beside the positions, and the film goes without.
    """

    def __init__(self, reward: ScoringReward) -> None:
        self._paid = reward.density

    def positions(self, positions: ArrayLike) -> bytes:
        """A PNG of the ball's positions, (n, 2) in pitch units, beside the densities."""
        from fbrl.figures.pitch import agent_figure

        figure = agent_figure(
            positions,
            self._paid or AssistDensity.default(),
            "Where the agent has the ball",
            is_paid=self._paid is not None,
        )
        file = io.BytesIO()
        figure.savefig(file, format="png", dpi=_DOTS_PER_INCH, bbox_inches="tight")
        return file.getvalue()

    def film(self, match: MatchRecording) -> bytes:
        """An animated GIF of a match from above: its first 40 seconds, at twice their speed.

        Raises:
            OSError: There is no room for it.
        """
        # cv2 and ffmpeg are loaded only here: nothing else in a training needs them.
        from fbrl.watch.pitch_view import PitchView
        from fbrl.watch.video import write_video

        frames = PitchView(self._paid, _VIDEO_WIDTH).frames(match)
        stride = max(1, round(_SECONDS_PER_PICTURE / match.seconds_per_step))
        shown = itertools.islice(frames, 0, round(_SECONDS / match.seconds_per_step), stride)
        with tempfile.TemporaryDirectory(prefix="fbrl-video-") as folder:
            path = Path(folder, "match.gif")
            write_video(path, shown, fps=_SPEED / (stride * match.seconds_per_step))
            return path.read_bytes()
