"""What TensorBoard makes of a run: the names' documentation, its own server, its page."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import time
import urllib.parse
import urllib.request

import numpy as np
import PIL.Image
import pytest
from conftest import REPOSITORY

from fbrl.cli.train import tensorboard_command
from fbrl.config import PPOConfig, TrainConfig
from fbrl.monitor import BALL_POSITIONS, IMAGES, MATCH_VIDEO, SCALARS
from fbrl.training.trainer import train

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "google-chrome"))), None
)
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="the page is looked at with headless Chromium, which is not installed"
)

FIRST_RUN_COLOUR = (255, 112, 67)
"""In which TensorBoard draws the lines of the first run."""


def test_the_table_of_the_documentation_has_every_name_with_its_meaning():
    text = (REPOSITORY / "docs" / "tensorboard.md").read_text(encoding="utf-8")
    table = re.findall(r"^\| `(\w+/\w+)` \| (.*) \|$", text, re.MULTILINE)
    expected = {}
    for name, meaning in {**SCALARS, **IMAGES}.items():
        if name.startswith("policy/action_"):
            action = name.removeprefix("policy/action_")
            name, meaning = "policy/action_NAME", meaning.removesuffix(action) + "NAME"
        expected[name] = meaning
    assert table == list(expected.items())


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    """A real run of four iterations, with an evaluation in between and one at the end.

    Each match ends within it, by its time limit at the latest.
    """
    path = tmp_path_factory.mktemp("tensorboard") / "run"
    ppo = PPOConfig(total_frames=1024, num_envs=2, num_steps=128, num_minibatches=2, num_epochs=1)
    scenario = "academy_empty_goal_close"
    train(TrainConfig(scenario, run_dir=path, eval_episodes=4, eval_interval=512, ppo=ppo))
    return path


@pytest.fixture(scope="module")
def address(run_dir, tmp_path_factory):
    """Where TensorBoard serves the run, started with the command that fbrl-train prints."""
    command = [*shlex.split(tensorboard_command(run_dir)), "--port", "0"]
    # The file has a name: a pipe that nobody empties may fill up.
    log = tmp_path_factory.mktemp("log") / "tensorboard.log"
    with log.open("w") as file:
        process = subprocess.Popen(command, stdout=file, stderr=file, env=os.environ)
    try:
        match = _wait_for(lambda: re.search(r"http://localhost:\d+/", log.read_text()), process)
        served = match.group()
        # It reads the files in the background.
        _wait_for(lambda: get_json(served, "data/plugin/scalars/tags").get("."), process)
        yield served
    finally:
        process.terminate()
        process.wait(timeout=30)


def _wait_for(condition, process):
    deadline = time.monotonic() + 120
    while not (result := condition()):
        assert process.poll() is None, "TensorBoard has ended"
        assert time.monotonic() < deadline, "TensorBoard doesn't answer"
        time.sleep(0.2)
    return result


def get_json(address, path, body=None, **query):
    data = None if body is None else json.dumps(body).encode()
    url = f"{address}{path}?{urllib.parse.urlencode(query)}"
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=300) as response:
        return json.load(response)


def test_it_serves_every_scalar_of_the_run(address):
    tags = set(get_json(address, "data/plugin/scalars/tags")["."])
    assert tags == set(SCALARS) - {"reward/checkpoint", "reward/potential"}


def test_it_serves_the_charts_with_their_lines(address):
    layout = get_json(address, "data/plugin/custom_scalars/layout")
    titles = [category["title"] for category in layout["category"]]
    assert titles == ["Goals", "Reward", "Play", "PPO", "Speed"]
    (margin,) = [c for c in layout["category"][0]["chart"] if "margin" in c]
    (series,) = margin["margin"]["series"]
    for tag in (series["value"], series["lower"], series["upper"]):
        answer = get_json(address, "data/plugin/custom_scalars/scalars", run=".", tag=f"^{tag}$")
        assert [step for _, step, _ in answer["tag_to_events"][tag]] == [512, 1024]


def test_it_compares_runs_by_their_hyperparameters_and_goal_difference(address):
    wanted = {"allowedStatuses": ["STATUS_UNKNOWN", "STATUS_RUNNING"], "sliceSize": 10}
    wanted["colParams"] = []
    (group,) = get_json(address, "data/plugin/hparams/session_groups", wanted)["sessionGroups"]
    assert group["hparams"]["reward"] == "analytics"
    assert group["hparams"]["ppo.num_steps"] == 128
    values = {value["name"]["tag"]: value["trainingStep"] for value in group["metricValues"]}
    names = ("goal_difference", "goal_difference_low", "goal_difference_high")
    assert values == {f"evaluation/{name}": 1024 for name in names}


@pytest.mark.parametrize(("name", "kind"), [(BALL_POSITIONS, "png"), (MATCH_VIDEO, "gif")])
def test_it_serves_pictures_that_a_browser_shows(name, kind, address):
    images = get_json(address, "data/plugin/images/images", run=".", tag=name, sample=0)
    assert [image["step"] for image in images] == [512, 1024]
    url = f"{address}data/plugin/images/individualImage?{images[-1]['query']}"
    with urllib.request.urlopen(url, timeout=300) as response:
        assert response.headers["Content-Type"] == f"image/{kind}"


def chromium(*arguments, height):
    # Virtual time: the page believes that it has had twenty seconds once nothing is pending.
    line = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000"]
    line += [f"--window-size=1400,{height}", *arguments]
    done = subprocess.run(line, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


@needs_chromium
def test_the_page_shows_the_curves_of_the_run(address):
    page = chromium("--dump-dom", f"{address}#timeseries", height=5000)
    text = " ".join(re.sub(r"<[^>]+>", " ", page).split())
    # TensorBoard opens the first groups with up to twelve cards each: those that matter most.
    shown = [tag for tag in SCALARS if re.search(rf"{tag.replace('/', ' ?/')}\b", text)]
    assert {"evaluation/goal_difference", "match/goal_difference", "match/win_share"} <= set(shown)
    assert len(shown) >= 15


@needs_chromium
def test_the_page_custom_scalars_shows_the_curves_of_the_run(address, tmp_path):
    path = tmp_path / "page.png"
    chromium(f"--screenshot={path}", f"{address}#custom_scalars", height=1600)
    pixels = np.asarray(PIL.Image.open(path).convert("RGB")).astype(int)
    lines = np.abs(pixels - FIRST_RUN_COLOUR).sum(-1) < 30
    # Right of the settings, in both columns of charts, far down the page.
    for left, right in ((380, 730), (730, 1080)):
        rows = np.flatnonzero(lines[:, left:right].any(1))
        assert len(rows) > 50
        assert rows[0] < 400
        assert rows[-1] > 1100
