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


def test_the_cuda_devices_that_there_are_are_named(monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    with pytest.raises(ConfigError, match="the last CUDA device here is cuda:1"):
        choose_device("cuda:3")
    assert choose_device("cuda:1") == torch.device("cuda:1")


def test_where_there_is_no_cuda_a_build_with_it_is_the_remedy(monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    with pytest.raises(ConfigError, match=r"no CUDA device.*Use cpu, or install a CUDA build"):
        choose_device("cuda")
