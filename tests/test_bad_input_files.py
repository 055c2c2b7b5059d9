"""Files of a run and of the commands with odd content, some of it on purpose."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from written_runs import write_run

from fbrl.agent import load_agent
from fbrl.analysis.run_log import RunLogError, read_run_log
from fbrl.assembly import make_model
from fbrl.checkpoint import FORMAT_VERSION, CheckpointError, load_checkpoint, save_checkpoint
from fbrl.config import ConfigError
from fbrl.config_json import config_from_dict, config_to_dict
from fbrl.density import AssistDensity
from fbrl.density.tables import read_event_files
from fbrl.monitor.table import drop_rows
from fbrl.presets import preset_config
from fbrl.watch.replay_file import load_replay

CONFIG = dataclasses.replace(
    preset_config("light", "academy_corner"), network_options={"hidden_sizes": (4, 3)}
)
OF_OTHER_TYPES = {
    "scenario": [None, 5, True, ["academy_corner"]],
    "reward": [5, None, ["analytics"], {"name": "analytics"}],
    "reward_options": [5, "a", {"density": 5}, {"density": ["uniform"]}, {"colour": 1}],
    "network_options": [{"hidden_sizes": v} for v in (5, "64", [64, "64"], [1.5], [True], None)],
    "density": [5, True, ["uniform"]],
    "seed": [0.5, "0", True, None],
    "device": [None, 0, ["cpu"]],
    "num_threads": [1.5, "2", True],
    "run_dir": [5, ["a"]],
    "checkpoint_interval": [1.5, "1", None],
    "eval_episodes": [0.5, "4", False],
    "eval_untrained": [1, "yes", None],
    "eval_pictures": [0, "no"],
    "ppo": [5, "x", [1]],
}
OF_OTHER_TYPES_IN_PPO = {
    "total_frames": [1e6, "1000", True],
    "num_envs": ["8", 8.0, True, None],
    "minibatch_size": ["64", 64.0],
    "learning_rate": ["0.001", None, True, 10**400],
    "anneal_learning_rate": [1, "yes", None],
    "gamma": ["0.9", [0.9]],
}


@pytest.mark.parametrize("name", OF_OTHER_TYPES)
def test_a_configuration_with_a_value_of_another_type_is_refused_by_its_name(name):
    for value in OF_OTHER_TYPES[name]:
        with pytest.raises(ConfigError) as error:
            config_from_dict({**config_to_dict(CONFIG), name: value})
        named = [
            name,
            *(value if isinstance(value, dict) else ()),
            "no configuration of a training",
        ]
        assert any(part in str(error.value) for part in named)


@pytest.mark.parametrize("name", OF_OTHER_TYPES_IN_PPO)
def test_so_is_a_hyperparameter(name):
    for value in OF_OTHER_TYPES_IN_PPO[name]:
        changed = dataclasses.replace(CONFIG.ppo, **{name: value})
        with pytest.raises(ConfigError, match=rf"{name} is .*; it must be of type"):
            changed.check()
        with pytest.raises(ConfigError, match=rf"{name} is .*; it must be of type"):
            dataclasses.replace(CONFIG, ppo=changed).check()


@pytest.mark.parametrize("values", [None, 5, "x", [], [1], {}])
def test_what_is_no_dictionary_is_no_configuration(values):
    with pytest.raises(ConfigError, match="no configuration of a training"):
        config_from_dict(values)


def agent_content(**changes):
    model = make_model(CONFIG, torch.device("cpu")).state_dict()
    return {"config": config_to_dict(CONFIG), "frames": 7, "model": model, **changes}


def with_sizes(*sizes):
    options = {"hidden_sizes": list(sizes), "activation": "relu"}
    return {**config_to_dict(CONFIG), "network_options": options}


CRAFTED = {
    "no configuration": ({"config": None}, "no configuration of a training"),
    "an empty configuration": ({"config": {}}, "no configuration of a training"),
    "another observation": (
        {"config": config_to_dict(preset_config("thesis", "5_vs_5"))},
        "weights",
    ),
    "a layer more": ({"config": with_sizes(4, 3, 3)}, "weights are not those of the network"),
    "too many layers": ({"config": with_sizes(*[1] * 10**5)}, "must be 1 to 64 positive widths"),
    "layers of petabytes": ({"config": with_sizes(10**7, 10**7)}, r"shape \(4, 115\), not"),
    "no weights": ({"model": {}}, "weights are not those"),
    "weights of another type": ({"model": [1, 2]}, "CheckpointError|AttributeError"),
    "numbers for weights": ({"model": dict.fromkeys(agent_content()["model"], 1.0)}, "Attribute"),
    "negative frames": ({"frames": -1}, "frames is -1"),
    "frames as a text": ({"frames": "7"}, "frames is '7'"),
}


@pytest.mark.parametrize("case", CRAFTED)
def test_a_whole_checkpoint_with_odd_content_is_refused_in_one_line(tmp_path, case):
    changes, message = CRAFTED[case]
    save_checkpoint(tmp_path / "odd.pt", **agent_content(**changes))
    with pytest.raises(CheckpointError, match=r"odd\.pt is not that of a training") as error:
        load_agent(tmp_path / "odd.pt")
    assert len(str(error.value).splitlines()) == 1
    with pytest.raises(CheckpointError, match=message):
        load_agent(tmp_path / "odd.pt")


def test_the_same_checkpoint_with_its_own_content_is_loaded(tmp_path):
    save_checkpoint(tmp_path / "good.pt", **agent_content())
    agent = load_agent(tmp_path / "good.pt")
    assert (agent.frames, agent.run_dir) == (7, None)
    assert agent.config.network_options == {"hidden_sizes": (4, 3)}


def nested(depth):
    """Lists within lists: a few hundred bytes that would take longer than the universe to read."""
    value = [0] * 10
    for _ in range(depth):
        value = [value] * 10
    return value


def wide():
    """A hundred thousand times the same list of as many numbers."""
    return [[0] * 100_000] * 100_000


def within_itself():
    value = []
    value.append(value)
    return value


@pytest.mark.parametrize(
    "content",
    [
        nested(40),
        wide(),
        within_itself(),
        torch.zeros(1).expand(10**6, 10**6),
    ],
    ids=["nested lists", "wide lists", "a list within itself", "an endless tensor"],
)
def test_a_checkpoint_that_would_take_for_ever_to_read_is_refused(tmp_path, content):
    torch.save({"format_version": FORMAT_VERSION, "sha256": "", "a": content}, tmp_path / "bomb.pt")
    with pytest.raises(CheckpointError, match=r"bomb\.pt is damaged"):
        load_checkpoint(tmp_path / "bomb.pt")


@pytest.mark.parametrize("version", [0, -1, True, 2.0, "2", None])
def test_a_version_that_there_is_not_is_refused(tmp_path, version):
    torch.save({"format_version": version, "sha256": ""}, tmp_path / "odd.pt")
    with pytest.raises(CheckpointError, match="no format version"):
        load_checkpoint(tmp_path / "odd.pt")


class Malicious:
    def __init__(self, target):
        self.target = str(target)

    def __reduce__(self):
        return os.mkdir, (self.target,)


def archive_of_pickles(path: Path, whole: Path, malicious: Malicious) -> None:
    """An ``.npz`` file each of whose arrays is replaced by a pickled one."""
    pickled = io.BytesIO()
    np.save(pickled, np.array([malicious], object), allow_pickle=True)
    with zipfile.ZipFile(whole) as good, zipfile.ZipFile(path, "w") as bad:
        for name in good.namelist():
            bad.writestr(name, pickled.getvalue())


@pytest.mark.parametrize("load", [AssistDensity.load, load_replay, load_checkpoint, load_agent])
@pytest.mark.parametrize("kind", ["plain pickle", "torch archive", "npz of pickles"])
def test_no_loader_runs_code_of_a_stranger(tmp_path, load, kind):
    target, path = tmp_path / "executed", tmp_path / "malicious"
    malicious = Malicious(target)
    if kind == "plain pickle":
        path.write_bytes(pickle.dumps(malicious))
    elif kind == "torch archive":
        torch.save({"format_version": 1, "config": malicious, "header": malicious}, path)
    else:
        AssistDensity.default().save(tmp_path / "whole.npz")
        archive_of_pickles(path, tmp_path / "whole.npz", malicious)
    with pytest.raises(ValueError, match="malicious"):
        load(path)
    assert not target.exists()
    # It would really do harm if it were loaded the usual way.
    if kind == "npz of pickles":
        with np.load(path, allow_pickle=True) as archive:
            assert len(archive["metadata"]) == 1
    else:
        torch.load(path, weights_only=False) if kind == "torch archive" else (
            pickle.loads(path.read_bytes())
        )
    assert target.exists()


@pytest.mark.parametrize("load", [AssistDensity.load, load_replay])
def test_a_file_of_kilobytes_that_unpacks_to_gigabytes_is_refused_at_once(tmp_path, load):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("header.npy", bytes(2**20))
        # As the directory of the archive would say of so many zeros.
        archive.infolist()[0].file_size = 2**31
    assert path.stat().st_size < 2**12
    with pytest.raises(ValueError, match=r"bomb\.npz.*unpacks to 2,147,483,648 bytes, more than"):
        load(path)


@pytest.mark.parametrize("load", [AssistDensity.load, load_replay])
@pytest.mark.parametrize("name", ["start.npy", "start", "a\x00b", "../start.npy"])
def test_a_member_that_is_no_array_is_refused(tmp_path, load, name):
    with zipfile.ZipFile(tmp_path / "odd.npz", "w") as archive:
        archive.writestr(name, b"no array")
    with pytest.raises(ValueError, match=r"odd\.npz.* is no array"):
        load(tmp_path / "odd.npz")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("config.json", "[" * 5000, "config.json is damaged"),
        ("config.json", '{"scenario": ' + "1" * 5000 + "}", "config.json is damaged"),
        ("config.json", "[]", "is no configuration of a training"),
        ("config.json", '{"scenario": "academy_corner", "ppo": {"gamma": "1"}}', "gamma is '1'"),
        ("metrics.csv", "frames,a\n1,2\nnan,3\n", "line 3 has nan as frames"),
        ("metrics.csv", "frames,a\n1,2\ninf,3\n", "line 3 has inf as frames"),
        ("metrics.csv", "frames,a\n0.5,2\n", "line 2 has 0.5 as frames"),
        ("metrics.csv", "frames,a\n-5,2\n", "line 2 has -5.0 as frames"),
        ("metrics.csv", "frames,a\n1," + "9" * 200_000 + "\n", "metrics.csv is not a CSV"),
        ("evaluations.csv", "frames,a\n1e999,2\n", "line 2 has inf as frames"),
    ],
)
def test_a_damaged_file_of_a_run_is_named_with_the_line(tmp_path, name, content, message):
    run = write_run(tmp_path / "run", {"frames": [1], "match/goal_difference": [0.5]})
    (run / name).write_text(content)

    def read():
        log = read_run_log(run)
        return log.metrics, log.evaluations

    with pytest.raises(RunLogError, match=message):
        read()


def test_a_damaged_line_is_dropped_where_a_training_goes_on(tmp_path):
    table = tmp_path / "metrics.csv"
    damaged = [b'2,"' + b"x" * 200_000 + b'"\n', b"9" * 5000 + b",1\n", b"\xff\xfe,1\n", b"3\n"]
    table.write_bytes(b"frames,a\n1,2\n" + b"".join(damaged) + b"4,5\n6,7\n")
    drop_rows(table, past=5)
    assert table.read_bytes() == b"frames,a\n1,2\n4,5\n"


def test_events_nested_too_deeply_are_refused_by_their_file(tmp_path):
    (tmp_path / "7.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match=r"7\.json is damaged or is no file of events"):
        read_event_files(tmp_path)


def test_a_replays_density_is_checked_too(tmp_path):
    header = {"format": "fbrl-matches", "version": 1, "matches": [{}], "density": {"start": True}}
    np.savez(tmp_path / "odd.npz", header=np.array(json.dumps(header)))
    with pytest.raises(ValueError, match=r"odd\.npz is damaged"):
        load_replay(tmp_path / "odd.npz")
