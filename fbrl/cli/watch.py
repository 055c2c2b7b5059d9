"""``fbrl-watch RUN_OR_CHECKPOINT``: a video of matches that an agent plays."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

# As in fbrl.cli.train: waiting threads must not take the cores from the matches.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from fbrl.allocator import preload_tcmalloc
from fbrl.cli.arguments import add_import, positive_integer, seed
from fbrl.cli.errors import Parser, ending_on_bad_input, ending_when_interrupted, fail
from fbrl.cli.outputs import check_outputs
from fbrl.cli.watch_display import WatchDisplay
from fbrl.policy_names import MODES, POLICIES
from fbrl.pretrained import pretrained_names
from fbrl.scenarios import check_scenario
from fbrl.watch.video import check_video_packages, check_video_path, write_video

if TYPE_CHECKING:
    import numpy as np

    from fbrl.density import AssistDensity
    from fbrl.watch.recording import MatchRecording
    from fbrl.watch.views import View

PROGRAM = "fbrl-watch"
WIDTHS = {"2d": 960, "3d": 640, "both": 1280}
SMALLEST_WIDTHS = {"2d": 320, "3d": 320, "both": 640}
LARGEST_WIDTH = 3840
TRIES_PER_GOAL = 50

_DESCRIPTION = """\
Play matches with a trained agent and make a video of them, without a display: from above with the
densities that the reward uses and its parts as they come in, as the engine draws it, or both side
by side. The same seed gives the same video."""

_EPILOG = """\
examples:
  fbrl-watch runs/academy_3_vs_1_with_keeper/my-run --out match.mp4
  fbrl-watch pretrained:academy_counterattack_hard --only goals
  fbrl-watch my-run --only goals --episodes 3 --view both --out goals.mp4
  fbrl-watch my-run --width 480 --only goals --out goal.gif
  fbrl-watch my-run --save-replay match.npz && fbrl-watch --replay match.npz --view 3d
  fbrl-watch --policy builtin-ai --scenario academy_counterattack_hard"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command; ends the process with 0, 2 on bad input, or 130 if interrupted."""
    with ending_when_interrupted(PROGRAM), ending_on_bad_input(PROGRAM):
        options = _parser().parse_args(arguments)
        preload_tcmalloc(PROGRAM)
        _main(options)
    sys.exit(0)


def _parser() -> Parser:
    parser = Parser(prog=PROGRAM, description=_DESCRIPTION, epilog=_EPILOG)
    parser.add_argument(
        "run",
        nargs="?",
        type=Path,
        metavar="RUN_OR_CHECKPOINT",
        help="whose agent plays, or pretrained:NAME, one that fbrl brings along: "
        + ", ".join(pretrained_names()),
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("match.mp4"),
        metavar="FILE",
        help="video to write, .mp4 or .gif (default: %(default)s)",
    )
    parser.add_argument(
        "--view",
        choices=tuple(WIDTHS),
        default="2d",
        help="from above, the engine's own picture, or both side by side (default: %(default)s)",
    )
    parser.add_argument(
        "--width",
        type=int,
        metavar="PIXELS",
        help=f"of the video, {SMALLEST_WIDTHS['2d']} to {LARGEST_WIDTH}, a multiple of 4 "
        "(default: 960, for 3d 640, for both 1280)",
    )
    parser.add_argument(
        "--fps", type=_fps, default=10.0, help="frames a second; 10 is real time (default: 10)"
    )

    played = parser.add_argument_group("matches that are played")
    played.add_argument("--episodes", type=positive_integer, help="how many (default: 1)")
    played.add_argument(
        "--only",
        choices=["goals"],
        help="leave out matches without a goal of either side; at most "
        f"{TRIES_PER_GOAL} are played for each one wanted",
    )
    played.add_argument("--scenario", help="default: the one trained on")
    played.add_argument(
        "--mode",
        choices=MODES,
        help="sample the actions, or take the most probable ones (default: sample)",
    )
    played.add_argument("--seed", type=seed, help="of the matches and actions (default: 0)")
    add_import(parser)
    played.add_argument("--device", help="auto, cpu, cuda (default: auto)")
    played.add_argument(
        "--policy", choices=POLICIES, help="instead of an agent; asks for --scenario"
    )
    played.add_argument(
        "--save-replay", type=Path, metavar="FILE", help="keep the matches too, for --replay"
    )
    parser.add_argument(
        "--replay", type=Path, metavar="FILE", help="show the matches of this file instead"
    )
    return parser


def _fps(text: str) -> float:
    value = float(text)
    if not 1 <= value <= 100:
        raise argparse.ArgumentTypeError(f"{value:g} is not in [1, 100]")
    return value


def _main(options: argparse.Namespace) -> None:
    started = time.monotonic()
    _check(options)
    check_video_packages()
    # Seconds of imports, which a mistyped option needn't wait for.
    from fbrl.envs.engine_pictures import RenderingError

    try:
        matches, frames = _make_video(options)
    except RenderingError as error:
        fail(PROGRAM, error)
    print(
        f"{options.out}: {matches} {'match' if matches == 1 else 'matches'}, {frames} frames "
        f"({frames / options.fps:.1f} s), made in {time.monotonic() - started:.1f} s"
    )


def _check(options: argparse.Namespace) -> None:
    """Refuses, before anything is played, what can't come to an end."""
    given = [name for name in ("run", "policy", "replay") if getattr(options, name) is not None]
    if len(given) != 1:
        raise ValueError(
            "Give one of RUN_OR_CHECKPOINT, --policy and --replay"
            f"{', not several' if given else ''} (see {PROGRAM} --help)."
        )
    if options.replay is not None:
        for name in ("episodes", "scenario", "mode", "seed", "device", "save_replay"):
            if getattr(options, name) is not None:
                option = f"--{name.replace('_', '-')}"
                raise ValueError(f"{option} is for matches that are played, not for --replay.")
    if options.policy is not None and options.scenario is None:
        raise ValueError("--policy needs a --scenario: no agent says which one.")
    if options.scenario is not None:
        check_scenario(options.scenario)
    if options.width is None:
        options.width = WIDTHS[options.view]
    smallest = SMALLEST_WIDTHS[options.view]
    if not smallest <= options.width <= LARGEST_WIDTH or options.width % 4:
        raise ValueError(
            f"--width is {options.width}; for --view {options.view} it must be a multiple of 4 in "
            f"[{smallest}, {LARGEST_WIDTH}]."
        )
    check_video_path(options.out)
    check_outputs(*(path for path in (options.out, options.save_replay) if path is not None))


def _make_video(options: argparse.Namespace) -> tuple[int, int]:
    """Plays, draws and writes; returns the numbers of matches and of frames."""
    from fbrl.cli.playing import playing
    from fbrl.watch.replay_file import save_replay
    from fbrl.watch.views import open_view

    with contextlib.ExitStack() as stack:
        if options.replay is None:
            stack.enter_context(playing(PROGRAM))
        display = stack.enter_context(WatchDisplay())
        matches, density = _matches(options, display)
        shown: list[MatchRecording] = []
        with open_view(options.view, options.width, density) as view:
            frames = _frames(options, view, matches, shown, display)
            count = write_video(options.out, frames, options.fps)
        if options.save_replay is not None:
            save_replay(options.save_replay, shown, density)
    return len(shown), count


def _matches(
    options: argparse.Namespace, display: WatchDisplay
) -> tuple[Iterable[MatchRecording], AssistDensity | None]:
    """The matches to show, played as they are asked for, and the density of their reward."""
    if options.replay is not None:
        from fbrl.envs.engine import load_gfootball
        from fbrl.watch.replay_file import load_replay

        if options.view != "2d":
            load_gfootball()
        return load_replay(options.replay)
    from fbrl.watch.recording import record_matches

    player = _player(options)
    wanted = options.episodes or 1
    reward = player["reward"]
    matches = record_matches(
        **player,
        episodes=wanted * TRIES_PER_GOAL if options.only else wanted,
        seed=options.seed or 0,
        greedy=options.mode == "greedy",
        on_progress=display.playing,
    )
    return matches, reward.density


def _player(options: argparse.Namespace) -> dict[str, Any]:
    """Who plays what, by the names of :func:`record_matches`'s arguments."""
    if options.policy is not None:
        from fbrl.envs.factory import make_reward
        from fbrl.evaluation.policies import make_policy

        return {
            "policy": make_policy(options.policy),
            "scenario": options.scenario,
            "observation": "simple115",
            "reward": make_reward("analytics"),
        }
    from fbrl.agent import load_agent
    from fbrl.assembly import make_agent_observation, make_training_reward
    from fbrl.device import choose_device

    device = choose_device(options.device or "auto")
    agent = load_agent(options.run, device)
    config = agent.config
    return {
        "policy": agent.model.get_collection_policy(),
        "scenario": options.scenario or config.scenario,
        "observation": make_agent_observation(config),
        "reward": make_training_reward(config, agent.run_dir),
        "device": device,
    }


def _frames(
    options: argparse.Namespace,
    view: View,
    matches: Iterable[MatchRecording],
    shown: list[MatchRecording],
    display: WatchDisplay,
) -> Iterator[np.ndarray]:
    """The frames of the matches that are wanted, which are added to ``shown`` one by one."""
    from fbrl.watch.captions import captioned_frames, num_frames

    wanted = len(matches) if isinstance(matches, list) else options.episodes or 1
    played = 0
    for match in matches:
        played += 1
        if options.only == "goals" and not sum(match.score):
            continue
        shown.append(match)
        title = f"match {len(shown)}" + (f" of {wanted}" if wanted > 1 else "")
        frames = captioned_frames(view, match, title, options.fps)
        total = num_frames(match, options.fps)
        for index, frame in enumerate(frames, start=1):
            display.drawing(len(shown), index, total)
            yield frame
        if len(shown) == wanted:
            return
    if not shown:
        raise ValueError(
            f"None of {played} matches had a goal. Try another --seed, --mode or --scenario, or "
            "leave out --only goals."
        )
