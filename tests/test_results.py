"""Results from runs, from tables of evaluations and from publications."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from written_runs import GOALS, write_run, write_table

from fbrl.analysis.results import (
    THESIS,
    Published,
    Result,
    ResultsError,
    convergence,
    final_goal_differences,
    read_evaluation_table,
    read_published,
)
from fbrl.analysis.run_groups import group_runs
from fbrl.analysis.run_log import read_run_log
from fbrl.checks import UnknownNameError

SHARED = Path(__file__).parents[2] / "shared"
CORNER, SHOOT = "academy_corner", "academy_pass_and_shoot_with_keeper"


@pytest.fixture
def groups(tmp_path):
    def groups(*goals, final=(0.5, 0.4, 0.6)):
        runs = [
            read_run_log(
                write_run(
                    tmp_path / f"run{seed}",
                    {"frames": [10, 20, 30], GOALS: values},
                    final,
                    scenario=CORNER,
                    seed=seed,
                )
            )
            for seed, values in enumerate(goals)
        ]
        return group_runs(runs, always=("reward",))

    return groups


def test_the_shipped_numbers_are_those_of_the_thesis():
    with (SHARED / "thesis" / "results.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["goal_difference"]]
    expected = {(row["scenario"], row["reward"], float(row["goal_difference"])) for row in rows}
    shipped = read_published(Path(THESIS), "goal-difference")
    assert {(row.scenario, row.reward, row.value) for row in shipped} == expected
    assert len(shipped) == len(rows) == 8
    assert {row.model.split(",")[0] for row in shipped} == {"thesis", "Kurach et al."}


class TestRuns:
    def test_the_last_evaluation_is_the_goal_difference(self, groups):
        assert final_goal_differences(groups([0, 0, 0], [0, 0, 0])) == [
            Result(CORNER, "analytics", "analytics", seed, 0.5, 0.4, 0.6) for seed in (0, 1)
        ]

    def test_a_run_that_was_not_evaluated_is_named_with_the_way_out(self, groups):
        with pytest.raises(ResultsError, match=r"run0 has no evaluation .*fbrl-eval --csv"):
            final_goal_differences(groups([0, 0, 0], final=None))

    def test_convergence_is_in_frames_and_infinite_if_never(self, groups):
        results = convergence(groups([0.1, 0.5, 0.6], [0.5, 0.45, 0.5], [0, 0, 0]), 0.5)
        assert [result.value for result in results] == [20, 30, math.inf]
        assert [(result.seed, result.low) for result in results] == [
            (0, None),
            (1, None),
            (2, None),
        ]

    def test_convergence_with_a_tolerance(self, groups):
        (result,) = convergence(groups([0.5, 0.45, 0.5]), 0.5, tolerance=0.1)
        assert result.value == 10


class TestEvaluationTable:
    @pytest.fixture
    def table(self, tmp_path):
        def table(*rows, drop=None):
            names = ["policy", "configuration", "reward", "trained_on", "seed", "scenario", "mode"]
            names += ["goal_difference", "goal_difference_low", "goal_difference_high", "matches"]
            columns = {
                name: [(*row, 0.5, 0.4, 0.6, 100)[index] for row in rows]
                for index, name in enumerate(names)
                if name != drop
            }
            return write_table(tmp_path / "eval.csv", columns)

        return table

    AT_HOME = ("run", "analytics", "analytics", CORNER, 3, CORNER, "sample")
    AWAY = ("run", "analytics", "analytics", CORNER, 3, SHOOT, "sample")
    GREEDY = ("run", "analytics", "analytics", CORNER, 3, SHOOT, "greedy")
    RANDOM = ("random", "", "", "", "", SHOOT, "")

    def test_generalisation_is_where_the_agent_was_not_trained(self, table):
        path = table(self.AT_HOME, self.AWAY, self.GREEDY)
        expected = Result(SHOOT, "analytics", "analytics", 3, 0.5, 0.4, 0.6)
        assert read_evaluation_table(path, "generalisation", "sample") == [expected]

    def test_goal_difference_is_where_it_was(self, table):
        path = table(self.AT_HOME, self.AWAY, self.GREEDY)
        (result,) = read_evaluation_table(path, "goal-difference", "sample")
        assert result.scenario == CORNER

    def test_the_mode_is_chosen(self, table):
        path = table(self.GREEDY)
        assert len(read_evaluation_table(path, "generalisation", "greedy")) == 1
        with pytest.raises(ResultsError, match=r"eval\.csv has no row .* mode sample; .* 1 other"):
            read_evaluation_table(path, "generalisation", "sample")

    def test_policies_that_were_not_trained_go_by_their_names(self, table):
        results = read_evaluation_table(table(self.AWAY, self.RANDOM), "generalisation", "sample")
        assert [(result.agent, result.seed) for result in results] == [
            ("analytics", 3),
            ("random", None),
        ]

    def test_what_an_evaluation_writes_is_read(self, tmp_path):
        from fbrl.config import TrainConfig
        from fbrl.evaluation.comparison import EvaluatedPolicy, baseline, result_row
        from fbrl.evaluation.evaluation import Evaluation

        evaluation = Evaluation({"goal_difference": np.array([1.0, 0.0, 1.0, 0.0])})
        agent = EvaluatedPolicy("run", lambda data: data, config=TrainConfig(CORNER, seed=3))
        rows = [
            result_row(evaluated, label, SHOOT, "greedy", 7, evaluation)
            for evaluated, label in (
                (agent, "analytics, density uniform"),
                (baseline("random"), None),
            )
        ]
        path = write_table(
            tmp_path / "eval.csv", {name: [row[name] for row in rows] for name in rows[0]}
        )
        low, high = evaluation.interval
        assert read_evaluation_table(path, "generalisation", "greedy") == [
            Result(SHOOT, "analytics, density uniform", "analytics", 3, 0.5, low, high),
            Result(SHOOT, "random", "", None, 0.5, low, high),
        ]

    def test_agents_of_several_schools_are_told_apart(self, table):
        other = ("run", "analytics", "analytics", "academy_corner", 3, SHOOT, "sample")
        third = ("run", "analytics", "analytics", "academy_3_vs_1_with_keeper", 3, SHOOT, "sample")
        results = read_evaluation_table(table(other, third), "generalisation", "sample")
        assert [result.agent for result in results] == [
            "analytics, from academy_corner",
            "analytics, from academy_3_vs_1_with_keeper",
        ]

    def test_at_home_an_agent_is_not_named_by_its_school(self, table):
        schools = [
            ("run", "analytics", "analytics", school, 3, school, "sample")
            for school in ("academy_corner", "academy_3_vs_1_with_keeper")
        ]
        results = read_evaluation_table(table(*schools), "goal-difference", "sample")
        assert [result.agent for result in results] == ["analytics", "analytics"]

    def test_a_missing_column_is_named(self, table):
        path = table(self.AWAY, drop="trained_on")
        with pytest.raises(ResultsError, match=r"eval\.csv has no column trained_on"):
            read_evaluation_table(path, "generalisation", "sample")


class TestPublished:
    @pytest.fixture
    def read(self, tmp_path):
        def read(text, measure="goal-difference"):
            (tmp_path / "thesis.csv").write_text(text)
            return read_published(tmp_path / "thesis.csv", measure)

        return read

    def test_rows_of_the_measure_are_read(self, read):
        text = (
            "scenario,reward,value,measure\n"
            f"{CORNER},scoring,0.5,goal-difference\n{CORNER},scoring,100000,convergence\n"
        )
        assert read(text) == [Published(CORNER, "scoring", 0.5)]
        assert read(text, "convergence") == [Published(CORNER, "scoring", 100_000)]
        with pytest.raises(ResultsError, match=r"thesis\.csv has no row of .* generalisation"):
            read(text, "generalisation")

    def test_without_that_column_all_rows_are(self, read):
        assert len(read(f"scenario,reward,value\n{CORNER},scoring,0\n", "convergence")) == 1

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "no column scenario and no reward and no value"),
            ("scenario,value\n", "no column reward"),
            (f"scenario,reward,value\n{CORNER},scoring\n", "line 2 has . values, the header 3"),
            (f"scenario,reward,value\n{CORNER},scoring,1,2\n", "line 2 has . values, the header 3"),
            (f"scenario,reward,value\n{CORNER},scoring,?\n", "has '\\?' as value"),
            (f"scenario,reward,value\n{CORNER},scoring,nan\n", "no finite number"),
            ("scenario,reward,value\nacademy_corners,scoring,1\n", "line 2: .*academy_corner\\?"),
            (f"scenario,reward,value\n{CORNER},score,1\n", "mean scoring\\?"),
            (
                f"scenario,reward,value,measure\n{CORNER},scoring,1,goals\n",
                "no measure 'goals'",
            ),
        ],
    )
    def test_a_damaged_table_is_named_with_what_is_wrong(self, read, text, message):
        with pytest.raises((ResultsError, UnknownNameError), match=rf"thesis\.csv.*{message}"):
            read(text)

    def test_a_missing_or_binary_table_is_named(self, tmp_path):
        (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
        for name, what in (("nowhere.csv", "cannot be read as a"), ("binary.csv", "is not a CSV")):
            with pytest.raises(ResultsError, match=rf"{name} {what} table"):
                read_published(tmp_path / name, "convergence")
