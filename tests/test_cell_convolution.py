"""The convolution of cells against drawn planes, PyTorch's convolution and its pooling."""

from __future__ import annotations

import doctest

import pytest
import torch
from torch.nn.functional import conv2d

import fbrl.models.cell_convolution
from fbrl.models.cell_convolution import convolve_and_pool_cells
from fbrl.models.impala import max_pool_same
from fbrl.transforms.minimap_grid import cells_to_planes


def scattered(frames):
    return torch.randint(-1, 6912, (5, frames, 24), dtype=torch.int16)


def crowded(frames):
    """Players next to each other and in the same cells, as in front of a goal."""
    rows, columns = torch.randint(33, 38, (5, frames, 24)), torch.randint(88, 96, (5, frames, 24))
    return (rows * 96 + columns).to(torch.int16)


def on_the_borders(frames):
    columns = torch.arange(96)
    border = torch.cat([columns, 71 * 96 + columns, columns[:72] * 96, columns[:72] * 96 + 95])
    return border[torch.randint(len(border), (5, frames, 24))].to(torch.int16)


def nobody(frames):
    return torch.full((2, frames, 24), -1, dtype=torch.int16)


def nobody_in_one(frames):
    return torch.cat([crowded(frames)[:1], nobody(frames), scattered(frames)[:1]])


def drawn(cells, weight, bias):
    planes = cells_to_planes(cells, weight.dtype)
    return max_pool_same(conv2d(planes, weight, bias, padding=1))


@pytest.mark.parametrize("frames", [1, 3, 4])
@pytest.mark.parametrize("make", [scattered, crowded, on_the_borders, nobody, nobody_in_one])
def test_values_and_gradients_are_those_of_the_drawn_planes(make, frames):
    torch.manual_seed(0)
    cells = make(frames)
    weight = torch.randn(6, 4 * frames, 3, 3, dtype=torch.float64, requires_grad=True)
    bias = torch.randn(6, dtype=torch.float64, requires_grad=True)
    expected, result = drawn(cells, weight, bias), convolve_and_pool_cells(cells, weight, bias)
    torch.testing.assert_close(result, expected)
    assert result.is_contiguous(memory_format=torch.channels_last)
    upstream = torch.randn_like(expected)
    for one, other in zip(
        torch.autograd.grad(result, (weight, bias), upstream),
        torch.autograd.grad(expected, (weight, bias), upstream),
        strict=True,
    ):
        torch.testing.assert_close(one, other)


def test_single_precision_agrees_too():
    torch.manual_seed(0)
    cells, weight, bias = scattered(4), torch.randn(16, 16, 3, 3), torch.randn(16)
    torch.testing.assert_close(
        convolve_and_pool_cells(cells, weight, bias), drawn(cells, weight, bias)
    )


def test_single_cells_give_what_their_planes_give():
    torch.manual_seed(0)
    weight, bias = torch.randn(2, 4, 3, 3), torch.randn(2)
    cell = torch.arange(6912)
    # Rows and columns at the borders, and one of even and of odd number in the middle.
    wanted = torch.isin(cell // 96, torch.tensor([0, 1, 2, 35, 36, 70, 71]))
    wanted |= torch.isin(cell % 96, torch.tensor([0, 1, 2, 47, 48, 94, 95]))
    cells = torch.full((int(wanted.sum()), 1, 24), -1, dtype=torch.int16)
    cells[:, 0, 22] = cell[wanted]
    torch.testing.assert_close(
        convolve_and_pool_cells(cells, weight, bias), drawn(cells, weight, bias)
    )


def test_documented_examples_run():
    outcome = doctest.testmod(fbrl.models.cell_convolution)
    assert outcome.attempted > 0
    assert outcome.failed == 0
