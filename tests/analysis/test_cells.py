# SPDX-License-Identifier: Apache-2.0
"""GroupFigures of many groups at once, against those of each group by itself."""

from __future__ import annotations

import math
import statistics
from typing import TYPE_CHECKING, Any

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from slamhive.analysis.cells import GroupFigures, Places, again
from slamhive.analysis.grouping import ranked_errors
from slamhive.analysis.statistics import (
    ENOUGH,
    Summary,
    mean_interval,
    median_interval,
    median_of_sorted,
)

if TYPE_CHECKING:
    import numpy.typing as npt

NUMBER = st.floats(-1e9, 1e9) | st.sampled_from([0.0, 0.1, 0.1, 1e-300])
ROW = st.tuples(NUMBER | st.just(float("nan")), st.booleans(), st.booleans(), st.integers(-1, 1))
GROUPS = st.lists(st.lists(ROW, min_size=1, max_size=2 * ENOUGH), min_size=1, max_size=6)
WORDS = ("Tracked", "Lost", "Failed")


def summary_of(values: npt.NDArray[np.float64]) -> Summary | None:
    """The summary of one group, number by number."""
    if not len(values):
        return None
    count, mean = len(values), math.fsum(values) / len(values)
    std = (
        math.sqrt(math.fsum((value - mean) ** 2 for value in values.tolist()) / (count - 1))
        if count > 1
        else None
    )
    return Summary(count, mean, std, statistics.median(values.tolist()), min(values), max(values))


def material(groups: list[list[tuple[float, bool, bool, int]]]) -> tuple[Any, ...]:
    """Rows of some groups in an order of their own, and which of them are whose."""
    rows = [(group, *row) for group, mine in enumerate(groups) for row in mine]
    shuffled = np.random.default_rng(0).permutation(len(rows))
    of_row = np.array([row[0] for row in rows])[shuffled]
    order = np.argsort(of_row, kind="stable")
    sizes = np.array([len(mine) for mine in groups])
    columns = [np.array([row[place] for row in rows])[shuffled] for place in (1, 2, 3, 4)]
    return Places(sizes, order), of_row, *columns


@given(GROUPS)
@example([[(1.0, False, True, 0)] * 3])
@example([[(0.1, True, False, 1)] * ENOUGH, [(2.0, True, True, 1)]])
def test_figures_are_those_of_each_group_by_itself(
    groups: list[list[tuple[float, bool, bool, int]]],
) -> None:
    places, of_row, values, inside, failed, _ = material(groups)
    inside &= ~failed  # a run that failed has no number that counts
    numbers = places.numbers(values, inside)
    plain = GroupFigures(numbers)
    ranked = GroupFigures(numbers, places.counts(failed))
    for group in range(len(groups)):
        rows = np.flatnonzero(of_row == group)
        mine = values[rows][inside[rows] & ~np.isnan(values[rows])]
        summary = summary_of(mine)
        assert plain[group].summary == ranked[group].summary == summary
        assert sorted(plain[group].points) == (sorted(mine.tolist()) if len(mine) < ENOUGH else [])
        assert plain[group].mean_interval == (mean_interval(summary) if summary else None)
        assert plain[group].median_interval == median_interval(np.sort(mine))
        behind = ranked_errors(values[rows], inside[rows], failed[rows])
        assert ranked[group].censored == np.count_nonzero(failed[rows])
        assert ranked[group].censored_median == (median_of_sorted(behind) if len(behind) else None)
        assert ranked[group].median_interval == median_interval(behind)


@given(GROUPS)
def test_words_are_counted_and_results_found_again_within_each_group(
    groups: list[list[tuple[float, bool, bool, int]]],
) -> None:
    places, of_row, _, inside, _, codes = material(groups)
    tallies = places.tallies(WORDS, codes + 1, inside)
    repeats = again(of_row, codes)
    for group in range(len(groups)):
        mine = codes[(of_row == group) & inside].tolist()
        counts = {word: mine.count(code - 1) for code, word in enumerate(WORDS)}
        assert tallies.get(group, {}) == {word: count for word, count in counts.items() if count}
        assert list(tallies.get(group, {})) == sorted(tallies.get(group, {}))
        every = codes[of_row == group].tolist()
        assert repeats[of_row == group].tolist() == [one in every[:k] for k, one in enumerate(every)]
