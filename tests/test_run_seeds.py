"""The seeds that follow from that of a training."""

from __future__ import annotations

from fbrl.presets import preset_config
from fbrl.run_seeds import fresh_seed, other_seed, seed_after_crashes


def test_an_evaluation_takes_another_seed_only_where_training_began_with_these_matches():
    config = preset_config("light", "academy_corner")
    assert fresh_seed(config, "academy_corner", config.seed) == other_seed(config.seed)
    assert fresh_seed(config, "academy_corner", config.seed + 1) == config.seed + 1
    assert fresh_seed(config, "academy_empty_goal", config.seed) == config.seed
    assert fresh_seed(None, "academy_corner", config.seed) == config.seed


def test_another_seed_is_a_seed_and_another_one():
    for seed in (0, 2**31, 2**32 - 1):
        assert 0 <= other_seed(seed) < 2**32
        assert other_seed(seed) != seed


def test_each_crash_gives_another_seed():
    assert seed_after_crashes(7, 0) == 7
    seeds = [seed_after_crashes(7, crashes) for crashes in range(20)]
    assert len(set(seeds)) == 20
    assert seeds == [seed_after_crashes(7, crashes) for crashes in range(20)]
    assert all(0 <= seed < 2**32 for seed in seeds)
