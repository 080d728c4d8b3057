# SPDX-License-Identifier: Apache-2.0
"""Threads that read and write images beside a recording."""

from __future__ import annotations

import itertools
from functools import partial
from typing import TYPE_CHECKING

import pytest

from slamhive.data.files.workers import Workers

if TYPE_CHECKING:
    from collections.abc import Iterator


def test_results_come_in_the_order_of_their_items() -> None:
    items = [(k, partial(pow, k, 2) if k % 3 else None) for k in range(100)]
    with Workers() as workers:
        assert list(workers.ahead(items)) == [(k, k**2 if k % 3 else None) for k in range(100)]


@pytest.mark.parametrize("has_work", [True, False])
def test_only_a_few_items_are_taken_ahead(has_work: bool) -> None:
    taken: list[int] = []

    def endless() -> Iterator[tuple[int, partial[int] | None]]:
        for k in itertools.count():
            taken.append(k)
            yield k, partial(abs, k) if has_work else None

    with Workers() as workers:
        assert next(workers.ahead(endless())) == (0, 0 if has_work else None)
    assert len(taken) <= (9 if has_work else 5000)


def test_a_failure_comes_at_its_place() -> None:
    with Workers() as workers:
        found = workers.ahead((k, partial(divmod, 1, 2 - k)) for k in range(20))
        assert [next(found)[0], next(found)[0]] == [0, 1]
        with pytest.raises(ZeroDivisionError):
            next(found)


def test_a_failure_of_later_work_isnt_lost() -> None:
    with pytest.raises(ZeroDivisionError), Workers() as workers:
        workers.later(partial(divmod, 1, 0))  # type: ignore[arg-type]
