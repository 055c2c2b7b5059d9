"""``fbrl-watch RUN_OR_CHECKPOINT``: a video of matches that an agent plays."""

from __future__ import annotations

import argparse
import contextlib
import functools
import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

# As in fbrl.cli.train: waiting threads must not take the cores from the matches.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from fbrl.allocator import preload_tcmalloc
from fbrl.cli.arguments import add_import, number_in, positive_integer, seed
from fbrl.cli.errors import Parser, ending_on_bad_input, ending_when_interrupted, fail, playing
from fbrl.cli.outputs import ProgressDisplay, check_outputs
from fbrl.policy_names import MODES, POLICIES
from fbrl.pretrained import pretrained_names
from fbrl.scenarios import SECONDS_PER_FRAME, check_scenario
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
    add = parser.add_argument
    add(
        "run",
        nargs="?",
        type=Path,
        metavar="RUN_OR_CHECKPOINT",
        help="whose agent plays, or pretrained:NAME, one that fbrl brings along: "
        + ", ".join(pretrained_names()),
    )
    add(
        "--out",
        type=Path,
        default=Path("match.mp4"),
        metavar="FILE",
        help="video to write, .mp4 or .gif",
    )
    add(
        "--view",
        choices=tuple(WIDTHS),
        default="2d",
        help="from above, the engine's own picture, or both side by side",
    )
    add(
        "--width",
        type=int,
        metavar="PIXELS",
        help=f"of the video, {SMALLEST_WIDTHS['2d']} to {LARGEST_WIDTH}, a multiple of 4 "
        "(default: 960, for 3d 640, for both 1280)",
    )
    add(
        "--fps",
        type=number_in(float, 1, 100, "in [1, 100]"),
        help="pictures a second (default: in real time: 10, or fewer with a frame skip)",
    )

    add_played = parser.add_argument_group("matches that are played").add_argument
    add_played("--episodes", type=positive_integer, help="how many (default: 1)")
    add_played(
        "--only",
        choices=["goals"],
        help="leave out matches without a goal of either side; at most "
        f"{TRIES_PER_GOAL} are played for each one wanted",
    )
    add_played("--scenario", help="default: the one trained on")
    add_played(
        "--mode",
        choices=MODES,
        help="sample the actions, or take the most probable ones (default: sample)",
    )
    add_played("--seed", type=seed, help="of the matches and actions (default: 0)")
    add_import(parser)
    add_played("--device", help="auto, cpu, cuda (default: auto)")
    add_played("--policy", choices=POLICIES, help="instead of an agent; asks for --scenario")
    add_played(
        "--save-replay", type=Path, metavar="FILE", help="keep the matches too, for --replay"
    )
    add("--replay", type=Path, metavar="FILE", help="show the matches of this file instead")
    return parser


def _main(options: argparse.Namespace) -> None:
    started = time.monotonic()
    _check(options)
    check_video_packages()
    # Seconds of imports, which a mistyped option needn't wait for.
    from fbrl.envs.engine_pictures import RenderingError

    try:
        matches, frames, seconds = _make_video(options)
    except RenderingError as error:
        fail(PROGRAM, error)
    print(
        f"{options.out}: {matches} {'match' if matches == 1 else 'matches'}, {frames} frames "
        f"({seconds:.1f} s), made in {time.monotonic() - started:.1f} s"
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
    check_outputs(options.out, options.save_replay)


def _make_video(options: argparse.Namespace) -> tuple[int, int, float]:
    """Plays, draws and writes; returns the numbers of matches, frames and seconds."""
    from fbrl.watch.replay_file import save_replay
    from fbrl.watch.views import open_view

    with contextlib.ExitStack() as stack:
        if options.replay is None:
            stack.enter_context(playing(PROGRAM))
        display = stack.enter_context(ProgressDisplay())
        matches, density, frame_skip = _matches(options, display)
        fps = options.fps or 1 / (SECONDS_PER_FRAME * frame_skip)
        shown: list[MatchRecording] = []
        with open_view(options.view, options.width, density) as view:
            frames = _frames(options, view, matches, fps, shown, display)
            count = write_video(options.out, frames, fps)
        if options.save_replay is not None:
            save_replay(options.save_replay, shown, density)
    return len(shown), count, count / fps


def _matches(
    options: argparse.Namespace, display: ProgressDisplay
) -> tuple[Iterable[MatchRecording], AssistDensity | None, int]:
    """The matches to show, played as they are asked for, their reward's density and frame skip."""
    if options.replay is not None:
        from fbrl.envs.engine import load_gfootball
        from fbrl.watch.replay_file import load_replay

        if options.view != "2d":
            load_gfootball()
        recorded, density = load_replay(options.replay)
        return recorded, density, recorded[0].frame_skip
    from fbrl.envs.factory import make_reward
    from fbrl.watch.recording import record_matches

    def show(finished: int, steps: int) -> None:
        display.show(f"playing match {finished + 1}", steps, None, "steps")

    wanted = options.episodes or 1
    record = functools.partial(
        record_matches,
        episodes=wanted * TRIES_PER_GOAL if options.only else wanted,
        seed=options.seed or 0,
        greedy=options.mode == "greedy",
        on_progress=show,
    )
    if options.policy is not None:
        from fbrl.evaluation.policies import make_policy

        policy, reward = make_policy(options.policy), make_reward("analytics")
        matches = record(policy, options.scenario, observation="simple115", reward=reward)
        return matches, reward.density, 1
    from fbrl.agent import load_agent
    from fbrl.assembly import make_agent_observation, make_training_reward
    from fbrl.device import choose_device

    device = choose_device(options.device or "auto")
    agent = load_agent(options.run, device)
    frame_skip = agent.config.ppo.frame_skip
    reward = make_training_reward(agent.config, agent.run_dir)
    matches = record(
        agent.model.get_collection_policy(),
        options.scenario or agent.config.scenario,
        observation=make_agent_observation(agent.config),
        reward=reward,
        frame_skip=frame_skip,
        device=device,
    )
    return matches, reward.density, frame_skip


def _frames(
    options: argparse.Namespace,
    view: View,
    matches: Iterable[MatchRecording],
    fps: float,
    shown: list[MatchRecording],
    display: ProgressDisplay,
) -> Iterator[np.ndarray]:
    """The frames of the matches that are wanted, which are added to ``shown`` one by one."""
    from fbrl.watch.views import captioned_frames, num_frames

    wanted = len(matches) if isinstance(matches, list) else options.episodes or 1
    played = 0
    for match in matches:
        played += 1
        if options.only == "goals" and not sum(match.score):
            continue
        shown.append(match)
        title = f"match {len(shown)}" + (f" of {wanted}" if wanted > 1 else "")
        frames = captioned_frames(view, match, title, fps)
        total = num_frames(match, fps)
        for index, frame in enumerate(frames, start=1):
            display.show(f"drawing match {len(shown)}", index, total, "frames")
            yield frame
        if len(shown) == wanted:
            return
    if not shown:
        raise ValueError(
            f"None of {played} matches had a goal. Try another --seed, --mode or --scenario, or "
            "leave out --only goals."
        )
