"""Matches to look at, recorded once for several test modules."""

from __future__ import annotations

import functools

import torch

from fbrl.watch.recording import MatchRecording, record_matches

SCENARIO = "academy_3_vs_1_with_keeper"
RIGHT, SHORT_PASS, SHOT, SPRINT = 5, 11, 12, 13


def pass_and_shoot(state):
    """Sprints to the right, passes, runs on, and shoots after two seconds."""
    steps_left = state["steps_left"].item()
    action = {400: SPRINT, 399: SHORT_PASS}.get(steps_left, SHOT if steps_left < 380 else RIGHT)
    return state.set("action", torch.full(state.batch_size, action))


def random_player(state):
    """Draws from torch's global random numbers, as a sampling agent does."""
    return state.set("action", torch.randint(19, state.batch_size))


@functools.cache
def recorded_matches() -> tuple[MatchRecording, ...]:
    """Two matches with the analytics reward, the first with a goal; nobody may write into them."""
    matches = record_matches(
        pass_and_shoot, SCENARIO, observation="simple115", reward="analytics", episodes=2, seed=3
    )
    return tuple(matches)
