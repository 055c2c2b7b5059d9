"""Statistics over seeds against results by hand, and how their intervals behave."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from fbrl.analysis import seed_statistics
from fbrl.analysis.seed_statistics import (
    Estimate,
    interquartile_mean,
    mean_curve,
    probability_of_improvement,
)


def normal(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


class TestInterquartileMean:
    def test_is_the_mean_of_the_middle_half(self):
        assert interquartile_mean([[100.0], [1.0], [3.0], [-50.0]]).value == 2.0
        # Over seeds and scenarios together: 1 2 | 3 4 5 6 | 7 800
        assert interquartile_mean([[1, 5], [800, 4], [3, 7], [2, 6]]).value == 4.5

    def test_is_the_plain_mean_of_fewer_than_four_numbers(self):
        assert interquartile_mean([[0.0], [1.0], [5.0]]).value == 2.0

    def test_seeds_are_drawn_within_their_scenario(self):
        # Each scenario's seeds agree, so drawing within it changes nothing.
        estimate = interquartile_mean([[0.0, 10.0, 20.0, 30.0]] * 3)
        assert estimate == Estimate(15.0, 15.0, 15.0)

    def test_the_interval_is_that_of_all_draws_within_the_scenarios(self):
        scores = np.array([[0.0, 10.0], [1.0, 14.0], [2.0, 20.0]])
        draws = [
            np.sort([*first, *second])[1:5].mean()
            for first in itertools.product(scores[:, 0], repeat=3)
            for second in itertools.product(scores[:, 1], repeat=3)
        ]
        estimate = interquartile_mean(scores)
        assert estimate.value == (1 + 2 + 10 + 14) / 4
        low, high = np.quantile(draws, [0.025, 0.975])
        assert (estimate.low, estimate.high) == pytest.approx((low, high), abs=0.25)

    def test_the_interval_holds_the_value_and_stays_within_the_scores(self):
        scores = normal(6, 5)
        estimate = interquartile_mean(scores)
        assert scores.min() < estimate.low < estimate.value < estimate.high < scores.max()

    def test_more_seeds_narrow_the_interval(self):
        few, many = (interquartile_mean(normal(count, 5)) for count in (4, 64))
        assert few.high - few.low > 2 * (many.high - many.low)

    def test_a_single_seed_has_no_interval(self):
        estimate = interquartile_mean([[1.0, 2.0, 3.0, 4.0]])
        assert (estimate.value, estimate.low, estimate.high) == (2.5, None, None)
        assert str(estimate) == "2.500 (one seed, no interval)"


class TestMean:
    def test_is_the_mean_with_an_interval(self):
        estimate = seed_statistics.mean([[0.0], [1.0], [5.0]])
        assert estimate.value == 2.0
        assert 0 <= estimate.low < 2.0 < estimate.high <= 5
        assert str(estimate) == f"2.000 [{estimate.low:.3f}, {estimate.high:.3f}]"


class TestProbabilityOfImprovement:
    def test_of_separated_samples_is_certain(self):
        high, low = [[2.0], [3.0]], [[0.0], [1.0], [1.5]]
        assert probability_of_improvement(high, low) == Estimate(1.0, 1.0, 1.0)
        assert probability_of_improvement(low, high) == Estimate(0.0, 0.0, 0.0)

    def test_of_equal_samples_is_one_half(self):
        same = [[1.0, 5.0], [2.0, 6.0], [3.0, 7.0]]
        estimate = probability_of_improvement(same, same)
        assert estimate.value == 0.5
        assert estimate.low < 0.5 < estimate.high

    def test_ties_count_one_half_and_scenarios_equally(self):
        # First scenario: 3 of the 4 pairs and a tie for half; second: none.
        a, b = [[1.0, 0.0], [2.0, 0.0]], [[1.0, 9.0], [0.0, 9.0]]
        assert probability_of_improvement(a, b).value == (3.5 / 4 + 0) / 2

    def test_is_mann_and_whitneys_statistic_as_a_share_of_the_pairs(self):
        a, b = normal(5, 4).round(1), normal(7, 4, seed=1).round(1) + 0.3
        expected = np.mean(stats.mannwhitneyu(a, b).statistic) / (5 * 7)
        assert probability_of_improvement(a, b).value == pytest.approx(expected)

    def test_the_interval_is_that_of_all_draws_of_both(self):
        a, b = [[0.0], [2.0], [5.0]], [[1.0], [3.0]]
        draws = [
            np.mean([x > y for x, y in itertools.product(some, others)])
            for some in itertools.product(*[np.ravel(a)] * 3)
            for others in itertools.product(*[np.ravel(b)] * 2)
        ]
        estimate = probability_of_improvement(a, b)
        assert (estimate.low, estimate.high) == pytest.approx(np.quantile(draws, [0.025, 0.975]))

    def test_a_single_seed_on_either_side_allows_no_interval(self):
        for a, b in (([[1.0]], [[0.0], [2.0]]), ([[0.0], [2.0]], [[1.0]])):
            assert probability_of_improvement(a, b) == Estimate(0.5, None, None)

    def test_other_scenarios_cannot_be_compared(self):
        with pytest.raises(ValueError, match="a has 2 scenarios and b 1"):
            probability_of_improvement(np.zeros((3, 2)), np.zeros((3, 1)))


class TestMeanCurve:
    def test_is_the_mean_at_each_point_with_its_own_interval(self):
        curves = np.array([[0.0, 1.0, 7.0], [0.0, 3.0, 7.0], [0.0, 5.0, 7.0]])
        middle, low, high = mean_curve(curves)
        assert middle.tolist() == [0, 3, 7]
        assert (low[0], high[0], low[2], high[2]) == (0, 0, 7, 7)
        assert 1 <= low[1] < 3 < high[1] <= 5

    @pytest.mark.parametrize(("count", "least", "most"), [(20, 0.9, 0.96), (3, 0.68, 0.8)])
    def test_intervals_cover_the_truth_as_documented(self, count, least, most):
        _, low, high = mean_curve(normal(count, 1000))
        assert least < np.mean((low <= 0) & (high >= 0)) < most

    def test_a_single_seed_is_its_own_curve_without_interval(self):
        middle, low, high = mean_curve([[0.5, 0.7]])
        assert (middle.tolist(), low, high) == ([0.5, 0.7], None, None)


def test_the_same_scores_give_the_same_interval_and_disturb_no_one():
    scores = normal(5, 3)
    np.random.seed(7)
    expected = np.random.random()
    np.random.seed(7)
    assert interquartile_mean(scores) == interquartile_mean(scores)
    assert np.random.random() == expected


@pytest.mark.parametrize("scores", [[1.0, 2.0], [[]], np.zeros((2, 2, 2)), [[1.0], [np.nan]]])
def test_scores_of_another_kind_are_refused(scores):
    for function in (interquartile_mean, seed_statistics.mean, mean_curve):
        with pytest.raises(ValueError, match=r"two axes, seeds first|not finite"):
            function(scores)
