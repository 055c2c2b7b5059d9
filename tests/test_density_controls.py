"""The controls: densities that hold no football."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fbrl.density import AssistDensity, open_density
from fbrl.density.controls import BUILT_IN, mean_over_pitch, mirrored, shuffled, uniform
from fbrl.presets import preset_config
from fbrl.transforms import AssistDensityReward


def anywhere(n: int = 200_000) -> torch.Tensor:
    random = np.random.default_rng(0)
    return torch.from_numpy(random.uniform([-1, -0.42], [1, 0.42], (n, 2)))


@pytest.fixture(scope="module")
def shipped():
    return AssistDensity.default()


@pytest.mark.parametrize("surface", ["start", "end"])
class TestControls:
    def test_uniform_pays_the_mean_everywhere(self, shipped, surface):
        fitted, control = (getattr(d, surface) for d in (shipped, uniform(shipped)))
        values = control(anywhere(100))
        assert values.max() == values.min()
        mean, error = fitted(anywhere()).mean(), fitted(anywhere()).std() / 200_000**0.5
        assert abs(values[0] - mean) < 4 * error
        assert control(torch.tensor([[1.01, 0.0], [0.0, 0.43]])).tolist() == [0, 0]

    def test_uniform_pays_an_agent_as_much_as_the_data_does_where_it_plays(self, shipped, surface):
        played = anywhere(500) * 0.2 + torch.tensor([0.6, 0.0])
        control = uniform(shipped, played)
        fitted = getattr(shipped, surface)
        assert getattr(control, surface)(anywhere(5)).tolist() == pytest.approx(
            [fitted(played).mean().item()] * 5
        )
        assert "mean at 500 positions" in control.metadata.source

    def test_mirrored_pays_at_the_other_end(self, shipped, surface):
        fitted, control = (getattr(d, surface) for d in (shipped, mirrored(shipped)))
        points = anywhere(1000)
        torch.testing.assert_close(
            control(points), fitted(points * torch.tensor([-1, 1])), atol=1e-6, rtol=0
        )

    def test_shuffled_pays_the_same_values_at_unrelated_places(self, shipped, surface):
        fitted, control = (getattr(d, surface) for d in (shipped, shuffled(shipped)))
        torch.testing.assert_close(
            control.grid.flatten().sort().values, fitted.grid.flatten().sort().values
        )
        both = torch.stack([control.grid.flatten(), fitted.grid.flatten()])
        assert abs(torch.corrcoef(both)[0, 1]) < 0.05
        assert mean_over_pitch(control) == pytest.approx(mean_over_pitch(fitted), rel=0.03)

    def test_shuffled_is_the_same_each_time_and_another_with_another_seed(self, shipped, surface):
        one, two, other = (
            getattr(d, surface).grid for d in (*[shuffled(shipped)] * 2, shuffled(shipped, 1))
        )
        assert torch.equal(one, two)
        assert not torch.equal(one, other)

    def test_peaks_but_the_constants_are_kept(self, shipped, surface):
        peaks = {name: getattr(open_density(name), surface).peak for name in BUILT_IN}
        assert peaks["mirrored"] == peaks["shuffled"] == peaks["default"]
        assert peaks["uniform"] < peaks["default"] / 4


class TestByName:
    @pytest.mark.parametrize("name", ["uniform", "mirrored", "shuffled"])
    def test_a_control_says_that_it_is_one_and_survives_its_file(self, tmp_path, name):
        density = open_density(name)
        assert density.metadata.source.startswith(name)
        density.save(tmp_path / "control.npz")
        loaded = open_density(tmp_path / "control.npz")
        assert loaded.metadata == density.metadata
        assert torch.equal(loaded.end.grid, density.end.grid)

    @pytest.mark.parametrize("name", BUILT_IN)
    def test_the_reward_takes_each_name(self, name):
        assert torch.equal(AssistDensityReward(name).density.end.grid, open_density(name).end.grid)

    def test_a_path_is_not_mistaken_for_a_name(self, tmp_path, monkeypatch, shipped):
        monkeypatch.chdir(tmp_path)
        shipped.save("uniform")
        assert torch.equal(open_density("./uniform").end.grid, shipped.end.grid)
        assert open_density("uniform").end.grid.shape == (2, 2)

    def test_another_name_is_answered_with_the_names(self):
        with pytest.raises(FileNotFoundError, match=r"unifrom.*default, uniform, mirrored"):
            open_density("unifrom")

    def test_the_density_of_the_configuration_may_be_a_name(self):
        import dataclasses

        config = preset_config("light", "academy_empty_goal")
        dataclasses.replace(config, reward_options={"density": "mirrored"}).check()
