"""Files of recorded matches."""

from __future__ import annotations

import io
import json
import pickle

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from watching import recorded_matches

from fbrl.density import AssistDensity
from fbrl.watch.replay_file import ReplayError, load_replay, save_replay


@pytest.fixture(scope="module")
def replay(tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "matches.npz"
    save_replay(path, recorded_matches(), AssistDensity.default())
    return path


def test_matches_and_density_come_back_as_they_were(replay):
    matches, density = load_replay(replay)
    for match, saved in zip(matches, recorded_matches(), strict=True):
        for field in ("scenario", "engine_seed", "episode_number", "score"):
            assert getattr(match, field) == getattr(saved, field)
        assert list(match.rewards) == list(saved.rewards)
        for arrays, others in (
            ({"actions": match.actions}, {"actions": saved.actions}),
            (match.observations, saved.observations),
            (match.rewards, saved.rewards),
        ):
            for key, array in arrays.items():
                assert array.dtype == others[key].dtype
                np.testing.assert_array_equal(array, others[key], err_msg=key)
    default = AssistDensity.default()
    assert density.metadata == default.metadata
    assert density.end.peak == default.end.peak
    assert (density.start.grid == default.start.grid).all()
    assert [path.name for path in replay.parent.iterdir()] == ["matches.npz"]


def test_a_match_without_a_density_has_none(tmp_path):
    save_replay(tmp_path / "matches.npz", recorded_matches()[:1])
    matches, density = load_replay(tmp_path / "matches.npz")
    assert (len(matches), density) == (1, None)


def changed(replay, **changes):
    """The file's bytes with other entries; ``None`` takes one out."""
    with np.load(replay) as archive:
        arrays = {key: archive[key] for key in archive.files}
    for name, change in changes.items():
        key = name.replace("__", "/")
        if change is None:
            del arrays[key]
        else:
            arrays[key] = change(arrays[key].copy())
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def with_value(value):
    def change(array):
        array.flat[-1] = value
        return array

    return change


def header_with(**fields):
    return lambda header: np.array(json.dumps({**json.loads(str(header)), **fields}))


def match_with(**fields):
    def change(header):
        header = json.loads(str(header))
        header["matches"][0].update(fields)
        return np.array(json.dumps(header))

    return change


DAMAGES = {
    "an array is missing": {"0__ball": None},
    "the header is missing": {"header": None},
    "another format": {"header": header_with(format="fbrl-assist-density")},
    "a newer version": {"header": header_with(version=99)},
    "a version of another type": {"header": header_with(version="1")},
    "no matches": {"header": header_with(matches=[])},
    "matches of another type": {"header": header_with(matches=7)},
    "a seed below 0": {"header": match_with(engine_seed=-1)},
    "a seed of another type": {"header": match_with(engine_seed="3")},
    "a reward that is not there": {"header": match_with(rewards=["reward_scoring", "reward_luck"])},
    "no rewards": {"header": match_with(rewards=[])},
    "a density that is not there": {"density__start": None},
    "a density below 0": {"density__start": with_value(-1.0)},
    "an unknown action": {"0__actions": with_value(20)},
    "actions as floats": {"0__actions": lambda array: array.astype(np.float32)},
    "one action too few": {"0__actions": lambda array: array[:-1]},
    "no steps": {"0__actions": lambda array: array[:0]},
    "a position that is NaN": {"1__ball": with_value(np.nan)},
    "an infinite position": {"0__left_team": with_value(np.inf)},
    "a player who is not there": {"0__active": with_value(11)},
    "an unknown game mode": {"0__game_mode": with_value(7)},
    "positions without y": {"0__right_team": lambda array: array[..., :1]},
    "a reward that is NaN": {"0__rewards__reward_scoring": with_value(np.nan)},
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_refused_with_its_name(replay, tmp_path, damage):
    path = tmp_path / "odd.npz"
    path.write_bytes(changed(replay, **DAMAGES[damage]))
    with pytest.raises(ReplayError, match=r"odd\.npz (holds no|is damaged|has format 99)"):
        load_replay(path)


def test_a_foreign_file_is_refused(tmp_path):
    marker = tmp_path / "executed"

    class Bomb:
        def __reduce__(self):
            return (open, (str(marker), "w"))

    np.savez(tmp_path / "pickled.npz", header=np.array([Bomb()], object))
    marker.unlink(missing_ok=True)
    np.save(tmp_path / "single.npy", np.zeros(3))
    (tmp_path / "plain.pkl").write_bytes(pickle.dumps({"a": 1}))
    (tmp_path / "text.npz").write_text("not a match")
    (tmp_path / "empty.npz").touch()
    for name in ("pickled.npz", "single.npy", "plain.pkl", "text.npz", "empty.npz", "none.npz"):
        with pytest.raises(ReplayError, match=name):
            load_replay(tmp_path / name)
    assert not marker.exists()


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_a_file_with_other_bytes_is_loaded_whole_or_refused(replay, tmp_path, data):
    content = bytearray(replay.read_bytes())
    if data.draw(st.booleans(), label="truncated"):
        content = content[: data.draw(st.integers(0, len(content) - 1))]
    else:
        content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    path = tmp_path / "odd.npz"
    path.write_bytes(content)
    try:
        matches, _ = load_replay(path)
    except ReplayError:
        return
    assert [match.num_steps for match in matches] == [m.num_steps for m in recorded_matches()]
