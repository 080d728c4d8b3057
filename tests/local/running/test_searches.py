# SPDX-License-Identifier: Apache-2.0
"""Searches on a workstation: what is tried follows from seed and results, whatever ends it in between."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.engine import PointState, RunSeen, Verdict
from slamhive.local.running.choosing import RunChoice
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.searching import SearchUnderWay
from slamhive.local.running.workbench import Workbench
from slamhive.model.search import SearchMethod, SearchRecord, TrialOrigin
from slamhive.plan import local_uid, plan_of
from slamhive.sampling import Sampler

from .sweeps import Notes, sweep_of
from .test_two_runners import Working

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.engine import TrialStanding
    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home
    from slamhive.model.results import RunRecord
    from slamhive.model.sweep import Sweep

NUMBERS = {"path": "parameters.number", "range": {"from": 0, "to": 40}}
REPETITIONS = {"first": 1, "promote": 2}


def search_of(trials: int = 6, name: str = "searched", axes: Any = None, **fields: Any) -> Sweep:
    """Return a search for the number that scores best."""
    search = {
        "method": "Random",
        "objectives": [{"metric": "metrics.score"}],
        "trials": trials,
        "atATime": 2,
        "repetitions": REPETITIONS,
    }
    return sweep_of(
        [], name, template={"parameters": {"act": "scored"}}, matrix=axes or [NUMBERS], search=search | fields
    )


def tried(archive: Archive, sweep: Sweep) -> list[int]:
    """Return the numbers that a search tried."""
    found = next(one.search for one in archive.sweeps() if one.uid == local_uid(sweep))
    assert found is not None
    return [trial.values[0] for trial in found.trials]


def score(number: int) -> int:
    """Return the score that the actor gives a number."""
    return (number - 7) ** 2


def undisturbed(sweep: Sweep, workshop: Workshop) -> tuple[list[int], list[TrialStanding]]:
    """Return the numbers that a search tries, and its best, by the score that the actor gives each run."""
    search = SearchUnderWay(plan_of(sweep, workshop), "", str)
    with Sampler() as sampler:
        while not search.decision.is_over:
            decision, plan = search.decision, search.plan
            if decision.told is not None:
                asked = (plan.trials, decision.standings, decision.told)
                plan.draw(sampler.propose(search.search, plan.space, *asked))
                continue
            index = decision.wanted[0]
            number = plan.point(index).spec["parameters"]["number"]
            search.seen[index] = RunSeen(has_failed=number > 20, values=(score(number),))
    return [trial.values[0] for trial in search.plan.trials], search.best


def test_a_search_tries_its_settings_and_promotes_the_good_ones(
    run_sweep: Callable, bench: Workbench
) -> None:
    job, notes = run_sweep(search_of())
    numbers = tried(bench.archive, job.sweep)
    assert (job.verdict, len(set(numbers)), len(job.points)) == (Verdict.COMPLETE, 6, 12)
    assert job.message.startswith("6 settings tried")
    good = [number for number in numbers if number <= 20]
    [best] = job.search.best
    assert numbers[best.number] == min(good, key=score)
    assert job.states[2 * best.number + 1] == PointState.SUCCEEDED
    # Those that score badly, or not at all, were run once.
    assert len(notes.records) < 12
    assert job.left_out == 12 - len(notes.records)
    again, nothing = run_sweep(search_of())
    assert (nothing.records, again.verdict) == ([], Verdict.COMPLETE)
    assert again.search.best == job.search.best


def test_more_trials_go_on_from_those_before(run_sweep: Callable, bench: Workbench) -> None:
    _, early = run_sweep(search_of(3))
    before = tried(bench.archive, search_of(3))
    job, late = run_sweep(search_of(6))
    assert tried(bench.archive, job.sweep)[:3] == before
    assert not {one.uid for one in early.records} & {one.uid for one in late.records}


class Ended(BaseException):
    """Stands for the end of the process."""


@pytest.mark.parametrize("runs", [0, 3])
def test_after_any_end_the_same_settings_are_tried_and_no_run_is_done_twice(
    home: Home, workshop: Workshop, bench: Workbench, run_sweep: Callable, runs: int
) -> None:
    """Ends just after a setting was written down, and after runs."""
    sweep, kept = search_of(), []
    expected, best = undisturbed(sweep, workshop)

    class Killed(Notes):
        def finished(self, job: Job, record: RunRecord) -> None:
            kept.append(record.uid)
            if len(kept) == runs:
                raise Ended

    class Dies(Archive):
        def change_search(self, *arguments: Any) -> SearchRecord:
            super().change_search(*arguments)
            raise Ended

    with (Archive if runs else Dies).open(home.archive_url) as archive:
        job = Job(sweep, local_uid(sweep), plan_of(sweep, workshop))
        runner = Runner(Workbench(home, workshop, archive), Killed(), parallelism=1)
        with pytest.raises(Ended):
            runner.run([job])
    job, notes = run_sweep(sweep)
    assert tried(bench.archive, sweep) == expected
    assert job.search.best == best
    assert not {record.uid for record in notes.records} & set(kept)


def test_two_runners_of_a_search_try_the_same_and_share_its_runs(
    home: Home, workshop: Workshop, bench: Workbench
) -> None:
    sweep = search_of(4, repetitions={})
    working = [Working(home, workshop, sweep) for _ in range(2)]
    done = [record.uid for one in working for record in one.end()]
    assert len(done) == len(set(done)) == bench.archive.count(sweep=sweep.name)
    numbers, best = undisturbed(sweep, workshop)
    assert tried(bench.archive, sweep) == numbers
    assert all(one.job.search.best == best for one in working)


def grid_of(numbers: list[int], **fields: Any) -> Sweep:
    """Return a grid of numbers."""
    axis = {"path": "parameters.number", "values": numbers}
    return sweep_of([], "grid", template={"parameters": {"act": "scored"}}, matrix=[axis], **fields)


def test_a_search_begins_with_what_the_archive_knows(run_sweep: Callable, bench: Workbench) -> None:
    run_sweep(grid_of([12, 3, 30, 6], repetitions=2))
    job, notes = run_sweep(search_of())
    trials = job.search.plan.trials
    known = [trial.values for trial in trials if trial.origin is TrialOrigin.KNOWN]
    # 30 crashed: that is no result that may be taken over.
    assert known == [[12], [3], [6]] == [trial.values for trial in trials[:3]]
    reused = [record for record in notes.records if record.provenance.reused_from]
    record = next(one.search for one in bench.archive.sweeps() if one.uid == job.uid)
    assert record.spared == len(reused) == job.reused >= 4
    assert job.search.best[0].score.values <= (1.0,)
    # What was written down counts, and not what is known since.
    run_sweep(grid_of([9]))
    again, nothing = run_sweep(search_of())
    assert (nothing.records, again.search.plan.trials) == ([], trials)


def test_of_very_much_that_is_known_the_best_half_is_taken(run_sweep: Callable) -> None:
    run_sweep(grid_of([0, 1, 2, 3, 4, 5, 6, 12, 13, 14]))
    job, _ = run_sweep(search_of(8, repetitions={}))
    known = [t.values[0] for t in job.search.plan.trials if t.origin is TrialOrigin.KNOWN]
    assert len(known) == 6
    assert {6, 5, 4} <= set(known)
    assert len(job.search.plan.trials) == 8


def test_who_wants_all_anew_takes_nothing_over(bench: Workbench, run_sweep: Callable) -> None:
    run_sweep(grid_of([12, 3, 6]))
    job, _ = run_sweep(search_of(2), rerun=True)
    assert all(trial.origin is TrialOrigin.DRAWN for trial in job.search.plan.trials)
    assert job.reused == 0


def test_a_search_of_a_space_that_is_smaller_does_the_grid(run_sweep: Callable) -> None:
    axes = [{"path": "parameters.number", "values": [5, 7, 9]}]
    job, _ = run_sweep(search_of(50, axes=axes, keep=1, repetitions={}))
    assert (job.verdict, len(job.points), job.count(PointState.SUCCEEDED)) == (Verdict.COMPLETE, 3, 3)


def test_a_budget_and_a_limit_of_failures_end_a_search(run_sweep: Callable) -> None:
    axes = [{"path": "parameters.number", "range": {"from": 21, "to": 40}}]
    sweep = search_of(axes=axes)
    sweep = sweep.replace(spec=sweep.spec.replace(max_failures=2))
    job, notes = run_sweep(sweep, parallelism=1)
    assert (job.verdict, len(notes.records)) == (Verdict.TOO_MANY_FAILURES, 3)


def test_failed_runs_are_done_again_where_asked(
    bench: Workbench, run_sweep: Callable, workshop: Workshop
) -> None:
    sweep = search_of()
    job, _ = run_sweep(sweep)
    failed = {index for index, state in enumerate(job.states) if state == PointState.FAILED}
    assert failed
    again = Job(sweep, job.uid, plan_of(sweep, workshop))
    watcher = Notes()
    Runner(bench, watcher, wish=RunChoice(retry_failed=True)).run([again])
    assert {record.index for record in watcher.records} == failed
    assert again.search.plan.trials == job.search.plan.trials


def test_a_threshold_is_sought(run_sweep: Callable) -> None:
    """By the bisection of the engine; runs above 20 fail."""
    sweep = sweep_of(
        [],
        template={"parameters": {"act": "scored"}},
        matrix=[NUMBERS],
        search={"method": SearchMethod.THRESHOLD, "axis": "parameters.number"},
    )
    job, notes = run_sweep(sweep)
    assert job.verdict is Verdict.COMPLETE
    numbers = {record.spec["parameters"]["number"] for record in notes.records}
    assert {20, 21} <= numbers
    assert len(numbers) < 15
