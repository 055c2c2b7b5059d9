"""The device of a name."""

from __future__ import annotations

import pytest
import torch

from fbrl.config import ConfigError
from fbrl.device import choose_device


@pytest.mark.parametrize("name", ["tpu", "cuda:99", "meta"])
def test_a_device_that_is_not_there_is_named(name):
    with pytest.raises(ConfigError, match=f"device is '{name}'"):
        choose_device(name)


def test_auto_is_cuda_where_there_is_one():
    expected = "cuda" if torch.cuda.is_available() else "cpu"
    assert choose_device("auto") == torch.device(expected)


def test_the_cpu_is_always_there():
    assert choose_device("cpu") == torch.device("cpu")
