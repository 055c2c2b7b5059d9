"""Pages say what the source says: scenarios, observations, actions; links lead somewhere."""

from __future__ import annotations

import re

import numpy as np
import pytest
from conftest import REPOSITORY

from fbrl.envs import OBSERVATION_SPACE, SCENARIOS
from fbrl.envs.actions import ACTION_NAMES

DOCS = REPOSITORY / "docs"
PAGES = [
    path
    for pattern in ("*.md", "docs/*.md", "docs/api/*.md", "experiments/*/README.md")
    for path in sorted(REPOSITORY.glob(pattern))
]


def table(page: str, heading: str) -> list[list[str]]:
    """The rows of the first table under a heading of a page, without the code marks."""
    text = (DOCS / page).read_text().split(f"\n{heading}\n", 1)[1]
    lines = re.search(r"\n(\|.*?\n)\n", text, flags=re.DOTALL).group(1).splitlines()
    rows = [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in lines]
    return rows[2:]


def test_the_table_of_scenarios_is_that_of_the_source():
    ends = {
        "ends_on_score": "goal",
        "ends_on_out_of_play": "stop",
        "ends_on_possession_change": "turnover",
    }
    expected = [
        [
            scenario.name,
            f"{scenario.left_players} v {scenario.right_players}",
            str(scenario.duration),
            f"{scenario.right_difficulty:g}",
            ", ".join(word for field, word in ends.items() if getattr(scenario, field))
            or "time only",
            "alternates" if scenario.alternating_kick_off else "ours",
        ]
        for scenario in SCENARIOS.values()
    ]
    assert table("environment.md", "## Scenarios") == expected


def test_the_table_of_observations_is_that_of_the_space():
    rows = table("environment.md", "## Observations")
    assert {row[0] for row in rows} == set(OBSERVATION_SPACE)
    for name, shape, dtype, bounds, _ in rows:
        space = OBSERVATION_SPACE[name]
        low, high = space.low.min(), space.high.max()
        assert shape == str(space.shape), name
        assert dtype == str(space.dtype), name
        assert bounds == (f"{low:g} to {high:g}" if np.isfinite(low) else ""), name


def test_the_table_of_actions_is_that_of_the_source():
    cells = [cell for row in table("environment.md", "## Actions") for cell in row]
    pairs = zip(cells[::2], cells[1::2], strict=True)
    described = {int(index): text for index, text in pairs if index}
    assert len(described) == len(ACTION_NAMES)
    for index, name in enumerate(ACTION_NAMES):
        assert described[index].startswith(name.replace("_", " "))


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_links_within_the_repository_lead_to_files(page):
    links = re.findall(r"\]\(([^)\s#]+)(?:#[^)\s]*)?\)", page.read_text())
    local = [link for link in links if "://" not in link]
    assert [link for link in local if not (page.resolve().parent / link).exists()] == []


def test_every_page_is_in_the_table_of_contents():
    index = (DOCS / "index.md").read_text()
    pages = {path.stem for path in DOCS.glob("*.md")} - {"index"}
    listed = set(re.findall(r"^(\w+)$", index, flags=re.MULTILINE))
    assert pages == listed


def test_the_readme_is_short():
    assert len((REPOSITORY / "README.md").read_text().splitlines()) < 150
