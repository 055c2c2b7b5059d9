"""The benchmark: equal work for all, clocks that add up, tables that say what was measured."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import needs_engine
from gymnasium import spaces
from tensordict import TensorDict

from benchmarks import sections
from benchmarks.__main__ import main
from benchmarks.measure_engine import _replay, random_actions, record_episodes, start_engine
from benchmarks.measure_time_shares import OTHER, REWARD_OF_COLLECTION, Stopwatch, time_shares
from benchmarks.measure_training import training_config
from benchmarks.results import SectionResults, load_results, save_results
from benchmarks.rounds import (
    DEFAULT_ENGINE,
    Build,
    Contestant,
    Row,
    WorkerError,
    run_rounds,
    run_worker,
    worker_environment,
)
from benchmarks.sections import FRAMES, QUICK, SECTIONS, STEPS, THREE_VS_ONE
from benchmarks.stable_baselines3_network import ImpalaFeatures, MLPFeatures
from benchmarks.tables import TABLES, write_page
from benchmarks.targets import targets, targets_table
from fbrl.envs import FootballEnv
from fbrl.envs.engine import FIRST_EPISODE
from fbrl.envs.matches import Matches
from fbrl.monitor import Monitor
from fbrl.presets import preset_config
from fbrl.transforms import MiniMapCells, Simple115
from fbrl.transforms.minimap import cells_to_planes
from fbrl.transforms.minimap_grid import frame_cells

REPOSITORY = Path(__file__).parent.parent
SEED, NUM_STEPS = 1, 120
MINIMAP_KEYS = MiniMapCells().in_keys

# gfootball's own wrappers need a stand-in for gym that no process of ours has.
PLAY_GFOOTBALL = """
import sys
import numpy as np
from benchmarks.gfootball_env import GFootballEnv, make_gfootball_env

scenario, seed, actions, path = sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4]
played = {}
for representation, stacked in (("extracted", True), ("simple115v2", False)):
    env = make_gfootball_env(scenario, representation, stacked=stacked, seed=seed)
    observations, rewards, dones = [env.reset()], [], []
    for action in map(int, actions.split(",")):
        observation, reward, done, _ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
        dones.append(done)
        if done:
            observations.append(env.reset())
    played[representation] = np.array(observations)
    played["rewards"], played["dones"] = np.array(rewards), np.array(dones)
    space = GFootballEnv(scenario, representation, stacked).observation_space
    assert space.contains(observations[-1]), space
np.savez(path, **played)
"""


def machine():
    return {
        "processor": "P",
        "cores": 2,
        "GPU": "none",
        "load before the run": 0.1,
        "date": "D",
        "commit": "abc",
    }


def results_of(*rows):
    return SectionResults(machine(), [Row(*row) for row in rows])


@needs_engine
def test_gfootballs_own_environment_plays_the_same_matches_as_ours(tmp_path):
    actions = np.random.default_rng(SEED).integers(19, size=NUM_STEPS).tolist()
    path = tmp_path / "played.npz"
    command = [sys.executable, "-c", PLAY_GFOOTBALL, THREE_VS_ONE, str(SEED)]
    subprocess.run([*command, ",".join(map(str, actions)), path], cwd=REPOSITORY, check=True)
    peer = np.load(path)

    transform = Simple115()
    env = FootballEnv(THREE_VS_ONE)
    planes, vectors, rewards, dones = [], [], [], []

    def observe(raw, frames):
        one = TensorDict(raw)
        cells = frame_cells(*(one[key].squeeze() for key in MINIMAP_KEYS))
        frames = [*frames[1:], cells] if frames else [cells] * 4
        planes.append(np.moveaxis(cells_to_planes(torch.stack(frames)).numpy(), 0, -1))
        vectors.append(transform(one)["simple115"].numpy())
        return frames

    frames = observe(env.reset(seed=SEED)[0], [])
    for action in actions:
        raw, reward, terminated, truncated, _ = env.step(action)
        rewards.append(reward)
        dones.append(terminated or truncated)
        frames = observe(raw, frames)
        if dones[-1]:
            frames = observe(env.reset(seed=SEED)[0], [])
    assert sum(dones) >= 2
    np.testing.assert_array_equal(peer["dones"], dones)
    np.testing.assert_array_equal(peer["rewards"], rewards)
    np.testing.assert_array_equal(peer["simple115v2"], np.array(vectors))
    np.testing.assert_array_equal(peer["extracted"], np.array(planes))


@needs_engine
def test_gfootballs_own_environment_is_refused_where_ours_has_imported_it():
    script = (
        "from fbrl.envs.engine import load_gfootball; load_gfootball();"
        "from benchmarks.gfootball_env import make_gfootball_env;"
        f"make_gfootball_env({THREE_VS_ONE!r}, 'extracted')"
    )
    process = subprocess.run(
        [sys.executable, "-c", script], cwd=REPOSITORY, capture_output=True, text=True
    )
    assert "already imported in this process" in process.stderr


def test_the_bare_engine_plays_the_recorded_matches():
    engine_seed, length = record_episodes(THREE_VS_ONE, 0.5, SEED)["episodes"][0]
    match = Matches(THREE_VS_ONE, 1, 1, ["ball", "left_team"])
    match.prepare(0, engine_seed, FIRST_EPISODE)
    match.begin([0])
    for action in random_actions(engine_seed)[:length]:
        match.step([0], [action])

    engine = start_engine()
    played = _replay(engine, THREE_VS_ONE, [(engine_seed, length)], seconds=60)
    assert (played.steps, played.resets) == (length, 1)
    info = engine.get_info()
    observed = {key: array[0].tolist() for key, array in match.observe().items()}
    assert observed["ball"] == [info.ball_position[axis] for axis in range(3)]
    positions = [[player.position[0], player.position[1]] for player in info.left_team]
    assert observed["left_team"][: len(positions)] == positions


def test_a_stopwatch_charges_nested_calls_once_and_its_parts_add_up():
    class Owner:
        def outer(self):
            time.sleep(0.02)
            self.inner()

        def inner(self):
            time.sleep(0.03)

    stopwatch = Stopwatch()
    with stopwatch.around(Owner, "outer", "outer"), stopwatch.around(Owner, "inner", "inner"):
        stopwatch.restart()
        started = time.perf_counter()
        Owner().outer()
        total = time.perf_counter() - started
    assert stopwatch.seconds["inner"] >= 0.03
    assert 0.02 <= stopwatch.seconds["outer"] <= total - stopwatch.seconds["inner"]
    assert sum(stopwatch.seconds.values()) == pytest.approx(total, abs=0.005)
    assert Owner.outer.__name__ == "outer"


def test_time_shares_of_a_training_add_up_to_a_hundred_and_leave_nothing_behind():
    log_iteration = Monitor.log_iteration
    shares = time_shares(THREE_VS_ONE, "mlp", num_steps=8, iterations=2, device="cpu", seed=SEED)
    of_collection = shares.pop(REWARD_OF_COLLECTION)
    assert sum(shares.values()) == pytest.approx(100)
    assert min(share for part, share in shares.items() if part != OTHER) > 0
    assert shares["matches"] > shares["logging"]
    assert shares["reward transform"] < of_collection < 50
    assert Monitor.log_iteration is log_iteration


@pytest.mark.parametrize(("network", "preset"), [("cnn", "thesis"), ("mlp", "light")])
def test_trainings_keep_the_presets_minibatches(network, preset):
    expected = preset_config(preset, THREE_VS_ONE).ppo
    ppo = training_config(THREE_VS_ONE, network, 128, 2, "cpu", SEED).ppo
    assert ppo.steps_per_minibatch == expected.steps_per_minibatch
    assert (ppo.num_envs, ppo.num_epochs) == (expected.num_envs, expected.num_epochs)
    assert ppo.num_batches == 2


def test_the_peer_trains_the_same_networks():
    torch.manual_seed(SEED)
    planes = (torch.rand(2, 16, 72, 96) < 0.01).to(torch.uint8) * 255
    impala = ImpalaFeatures(spaces.Box(0, 255, (16, 72, 96), np.uint8))
    torch.testing.assert_close(impala(planes.float() / 255), impala.network(planes))
    vectors = torch.randn(2, 115)
    mlp = MLPFeatures(spaces.Box(-np.inf, np.inf, (115,), np.float32))
    torch.testing.assert_close(mlp(vectors), mlp.network(vectors))


def test_a_failed_measurement_names_itself_and_the_reason():
    contestant = Contestant("the case", "the contestant", "builtins:int", {"base": 10})
    with pytest.raises(WorkerError, match=r"(?s)the case, the contestant: .*TypeError"):
        run_worker(contestant, seed=1)


def test_contestants_take_turns_and_get_the_round_as_their_seed():
    contestants = [
        Contestant("case", "A", "builtins:dict"),
        Contestant("case", "B", "builtins:dict", first_round_only=True),
        Contestant("case", "C", "builtins:dict"),
    ]
    lines = []
    rows = [(r.name, r.round, r.figure, r.value) for r in run_rounds(contestants, 2, lines.append)]
    first = [("A", 0, "seed", 1), ("B", 0, "seed", 1), ("C", 0, "seed", 1)]
    assert rows == [*first, ("A", 1, "seed", 2), ("C", 1, "seed", 2)]
    assert lines[-1].startswith("5/5, ")


def test_a_peer_runs_on_the_default_build_without_our_settings(monkeypatch):
    monkeypatch.setenv("OMP_WAIT_POLICY", "PASSIVE")
    monkeypatch.setenv("LD_PRELOAD", "")
    monkeypatch.setenv("PYTHONPATH", "modules")
    peer = worker_environment(Build.DEFAULT)
    assert peer["PYTHONPATH"] == f"{DEFAULT_ENGINE}:modules"
    assert not {"OMP_WAIT_POLICY", "LD_PRELOAD"} & set(peer)
    ours = worker_environment(Build.FBRL)
    assert ours["PYTHONPATH"] == "modules"
    assert ours["OMP_WAIT_POLICY"] == "PASSIVE"


def test_ratios_are_taken_within_a_round():
    slowing_down = results_of(
        ("case", "ours", 0, FRAMES, 300.0),
        ("case", "peer", 0, FRAMES, 100.0),
        ("case", "ours", 1, FRAMES, 30.0),
        ("case", "peer", 1, FRAMES, 10.0),
        ("case", "ours", 2, FRAMES, 5.0),
    )
    ratio = slowing_down.summary("case", "ours", FRAMES, "peer")
    assert (ratio.median, ratio.low, ratio.high) == (3, 3, 3)
    assert slowing_down.summary("case", "ours", FRAMES).median == 30
    assert slowing_down.summary("case", "ours", FRAMES, "nobody") is None


def test_results_are_read_as_they_were_written(tmp_path):
    results = {
        "engine": results_of(("case", "name", 0, FRAMES, 1.25), ("case", "b", 1, STEPS, 2.0))
    }
    save_results(results, tmp_path / "new" / "results.json")
    assert load_results(tmp_path / "new" / "results.json") == results
    assert load_results(tmp_path / "none.json") == {}


def test_tables_replace_their_own_and_leave_the_text_around_them(tmp_path):
    page = tmp_path / "page.md"
    begin, end = "<!-- benchmark: vectorisation -->", "<!-- end of benchmark: vectorisation -->"
    page.write_text(f"before\n{begin}\nold\n{end}\nafter\n")
    for value in (1000.0, 2000.0):
        results = {"vectorisation": results_of(("8", "threads", 0, FRAMES, value))}
        write_page(results, page)
    text = page.read_text()
    assert text.startswith(f"before\n{begin}\n| matches |")
    assert "after\n" in text
    assert "2,000 [2,000, 2,000]" in text
    assert "1,000" not in text
    assert "old" not in text
    assert text.count("<!-- benchmark: targets -->") == 1


def test_a_target_is_met_by_the_median():
    case = sections.training_case(THREE_VS_ONE, "mlp")

    def table(*ratios):
        rows = []
        for number, ratio in enumerate(ratios):
            rows += [(case, sections.FBRL, number, FRAMES, ratio)]
            rows += [(case, sections.PEER, number, FRAMES, 1.0)]
        lines = targets_table({"training": results_of(*rows)}).splitlines()
        return next(line for line in lines if case in line and "Stable-Baselines3" in line)

    assert table(1.0, 5.5, 5.5).endswith("| at least 5 | 5.5 [1, 5.5] | yes |")
    assert table(4.9, 4.9, 5.5).endswith("| at least 5 | 4.9 [4.9, 5.5] | **no** |")
    assert all("not measured" in line for line in targets_table({}).splitlines()[2:])


def test_every_target_is_on_something_that_is_measured():
    for target in targets():
        contestants = SECTIONS[target.section](sections.FULL)
        measured = {(contestant.case, contestant.name) for contestant in contestants}
        assert (target.case, target.name) in measured
        assert target.peer is None or (target.case, target.peer) in measured
    assert set(TABLES) == set(SECTIONS)


@needs_engine
@pytest.mark.slow
def test_a_quick_run_measures_every_contestant_and_writes_tables_and_picture(tmp_path):
    for section in ("engine", "environment"):
        main(["--quick", section, "--output", str(tmp_path)])
    content = json.loads((tmp_path / "performance.json").read_text())
    assert list(content) == ["engine", "environment"]
    page = (tmp_path / "performance.md").read_text()
    for section in ("engine", "environment"):
        there = [c for c in SECTIONS[section](QUICK) if c.build.is_there]
        measured = {(case, name) for case, name, _, figure, _ in content[section]["rows"]}
        assert measured == {(c.case, c.name) for c in there}
        assert all(value > 0 for *_, value in content[section]["rows"])
        assert content[section]["machine"]["cores"] >= 1
    table = page.partition("<!-- benchmark: environment -->")[2].partition("<!-- end")[0]
    for name in (sections.MINIMAP, sections.TRAINING_ENV, sections.SMM + sections.ON_OUR_ENGINE):
        assert re.search(rf"\| {THREE_VS_ONE} \| {re.escape(name)} \| [\d,.]+ \[", table)
    assert (tmp_path / "img" / "performance.png").read_bytes().startswith(b"\x89PNG")


def test_an_unknown_section_is_answered_with_those_that_there_are(run_main):
    printed = run_main(main, "--quick", "speed", code=2)
    assert "no section 'speed'; there are engine, environment" in printed.err.splitlines()[-1]
