"""A run keeps the densities that it was trained with."""

from __future__ import annotations

import dataclasses
import shutil

import pytest
import torch

from fbrl.agent import load_agent
from fbrl.analysis.run_log import read_run_log
from fbrl.assembly import keep_density, make_training_reward
from fbrl.config import ConfigError, PPOConfig, TrainConfig
from fbrl.density import AssistDensity, open_density
from fbrl.evaluation.comparison import trained
from fbrl.run_files import DENSITY_NAME
from fbrl.training.evaluator import MatchPictures
from fbrl.training.trainer import train
from fbrl.transforms import AssistDensityReward, ScoringReward

PPO = PPOConfig(total_frames=16, num_envs=1, num_steps=16, num_minibatches=2, num_epochs=1)


def config(run_dir, **changes):
    chosen = {
        "network_options": {"hidden_sizes": (4,)},
        "eval_episodes": 0,
        "ppo": PPO,
        "run_dir": run_dir,
        **changes,
    }
    return TrainConfig("academy_empty_goal_close", **chosen)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run in another place than where it was trained, whose density file is gone."""
    folder = tmp_path_factory.mktemp("density")
    open_density("mirrored").save(folder / "mine.npz")
    train(config(folder / "run", reward_options={"density": str(folder / "mine.npz")}))
    (folder / "mine.npz").unlink()
    return (folder / "run").rename(folder / "moved")


def density_of(reward):
    assert isinstance(reward, AssistDensityReward)
    return reward.density


def assert_mirrored(density):
    expected = open_density("mirrored")
    assert torch.equal(density.start.corners, expected.start.corners)
    assert torch.equal(density.end.corners, expected.end.corners)
    assert density.start.peak == expected.start.peak
    assert density.metadata == expected.metadata


def test_the_densities_are_kept_bit_for_bit(run):
    assert_mirrored(AssistDensity.load(run / DENSITY_NAME))


def test_its_agent_is_evaluated_and_watched_without_the_file(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in (run, run / "checkpoints" / "last.pt"):
        agent = load_agent(path)
        assert agent.run_dir == run
        assert_mirrored(density_of(make_training_reward(agent.config, agent.run_dir)))
        assert_mirrored(density_of(trained(path, torch.device("cpu")).reward))


def test_its_training_goes_on_without_the_file(run, tmp_path):
    copied = shutil.copytree(run, tmp_path / "copied")
    before = read_run_log(copied).config
    longer = dataclasses.replace(PPO, total_frames=32)
    result = train(dataclasses.replace(before, run_dir=copied, ppo=longer), resume=True)
    assert result.frames == 32
    assert_mirrored(AssistDensity.load(copied / DENSITY_NAME))
    assert read_run_log(copied).config.reward_options == before.reward_options


def test_a_checkpoint_that_lies_alone_asks_for_the_file(run, tmp_path):
    shutil.copy(run / "checkpoints" / "last.pt", tmp_path / "alone.pt")
    assert load_agent(tmp_path / "alone.pt").run_dir is None
    with pytest.raises(ConfigError, match=r"No density file at .*mine\.npz"):
        trained(tmp_path / "alone.pt", torch.device("cpu"))


def test_a_damaged_copy_is_named(run, tmp_path):
    copied = shutil.copytree(run, tmp_path / "copied")
    (copied / DENSITY_NAME).write_bytes(b"nothing")
    with pytest.raises(ConfigError, match=r"copied/density\.npz is not a readable density file"):
        trained(copied, torch.device("cpu"))


def test_a_reward_without_densities_keeps_none(tmp_path):
    train(config(tmp_path / "run", reward="scoring"))
    assert not (tmp_path / "run" / DENSITY_NAME).exists()


class PaidForSomethingElse(ScoringReward):
    """A user's own reward, which has densities too."""

    def __init__(self):
        super().__init__()
        self.density = open_density("mirrored")


def test_the_densities_of_a_reward_of_ones_own_are_kept_and_drawn_as_those_that_are_paid(tmp_path):
    pytest.importorskip("mplsoccer")
    keep_density(PaidForSomethingElse(), tmp_path)
    assert_mirrored(AssistDensity.load(tmp_path / DENSITY_NAME))
    own, shipped_one, none = (
        MatchPictures(reward).positions([[0.5, 0.0]])
        for reward in (PaidForSomethingElse(), AssistDensityReward("mirrored"), ScoringReward())
    )
    assert own == shipped_one != none
