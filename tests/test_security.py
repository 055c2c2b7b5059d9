"""Nothing listens on the network, and nothing that a user types reaches a shell."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import psutil

from fbrl.config import PPOConfig, TrainConfig
from fbrl.training import TrainListener, train

REPOSITORY = Path(__file__).parent.parent
SOURCES = sorted(
    path for folder in ("fbrl", "benchmarks") for path in (REPOSITORY / folder).rglob("*.py")
)
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]


def test_a_training_listens_nowhere(tmp_path):
    ppo = PPOConfig(total_frames=32, num_envs=2, num_steps=16, num_minibatches=2, num_epochs=1)
    config = TrainConfig(
        "academy_empty_goal_close",
        network_options={"hidden_sizes": (4,)},
        eval_episodes=0,
        ppo=ppo,
        run_dir=tmp_path,
    )
    listening = []

    def look(*_):
        process = psutil.Process()
        for one in (process, *process.children(recursive=True)):
            listening.append([c for c in one.net_connections("inet") if c.status == "LISTEN"])

    train(config, TrainListener(on_metrics=look))
    assert listening
    assert not any(listening)


def test_no_command_goes_through_a_shell():
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in ("os.system", "os.popen", "subprocess.getoutput"), path
                assert not any(keyword.arg == "shell" for keyword in node.keywords), path


def test_every_tensorboard_that_is_shown_stays_on_this_machine():
    commands = [
        line
        for page in PAGES
        for line in page.read_text(encoding="utf-8").splitlines()
        if re.match(r"\s*(\S*/)?tensorboard\s+-", line)
    ]
    assert len(commands) >= 2
    for command in commands:
        assert "--host localhost" in command
        assert "--bind_all" not in command
