"""The documentation of TensorBoard's names, and the page that TensorBoard makes of a run."""

from __future__ import annotations

import re

from conftest import REPOSITORY

from fbrl.monitor import IMAGES, SCALARS


def test_the_table_of_the_documentation_has_every_name_with_its_meaning():
    text = (REPOSITORY / "docs" / "tensorboard.md").read_text(encoding="utf-8")
    table = re.findall(r"^\| `(\w+/\w+)` \| (.*) \|$", text, re.MULTILINE)
    expected = {}
    for name, meaning in {**SCALARS, **IMAGES}.items():
        if name.startswith("action/"):
            action = name.removeprefix("action/")
            name, meaning = "action/NAME", meaning.removesuffix(action) + "NAME"
        expected[name] = meaning
    assert table == list(expected.items())
