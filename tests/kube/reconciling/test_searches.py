# SPDX-License-Identifier: Apache-2.0
"""Searches: what a Sweep tries, written down before it runs, whatever becomes of operators meanwhile."""

from __future__ import annotations

import json
import math
from functools import partial
from random import Random
from typing import TYPE_CHECKING, Any

import pytest
from fakeapi.evaluators import good
from fakeapi.resources import named
from testcluster.lab import condition_of, dataset, status_of, sweep, until

from slamhive.archive import Archive
from slamhive.jobs.lines import encode_all
from slamhive.kube.api.kinds import Key, Kind, Label
from slamhive.kube.reconciling.sweep_search import require_room
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.search import Trial
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, SearchPlan

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from testcluster.lab import Lab

    from slamhive.kube.operator import Operator

QUICK = {"evaluation": {"delaySeconds": 0.05}}


class Dice:
    """A sampler in this process that never proposes the same twice."""

    def __init__(self) -> None:
        self.asked: list[int] = []
        self.broken = False

    def propose(
        self, search: Any, space: Any, trials: Sequence[Trial], standings: Sequence[Any], told: int
    ) -> Trial | None:
        if self.broken:
            raise SystemFault("the sampler TPE: it ran into its limits")
        assert all(one.is_decided for one in standings[:told])
        self.asked.append(len(trials))
        low, high = space.axes[0].ends
        return Trial(values=[Random(len(self.asked) - 1).uniform(low, high)], told=told)


def search(trials: int = 4, retention: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
    """Return a search over the parameter ``size`` across two datasets."""
    given = {
        "method": "Random",
        "objectives": [{"metric": "ate.rmse"}],
        "trials": trials,
        "keep": 2,
        "atATime": 2,
    }
    axes = [
        {"path": "parameters.size", "range": {"from": 0.5, "to": 4}},
        {"path": "dataset", "values": ["hall", "yard"]},
    ]
    spec = {"matrix": axes, "search": given | changes, "parallelism": 4, "retention": retention or {}}
    return sweep(template={"evaluate": True}, **spec)


def error_of(run: dict[str, Any]) -> float:
    """Return the error that a run is played to have, m: the best size is 2."""
    shift = 0.1 if run["spec"]["datasetRef"]["name"] == "yard" else 0.0
    return float(0.1 + abs(math.log(run["spec"]["parameters"]["size"] / 2)) + shift)


@pytest.fixture
def make_search_lab(make_fake_lab: Callable[..., Lab]) -> Callable[..., Lab]:
    """A function that gives a fake cluster whose evaluators tell an error that follows from the setting."""

    def make(**play: Any) -> Lab:
        lab = make_fake_lab(**play)
        lab.apply(dataset("yard"))
        objects = lab.cluster._objects  # type: ignore[union-attr] - logs are asked for in its own thread

        def log(pod: dict[str, Any], _container: str) -> str:
            asked = json.loads(pod["metadata"]["annotations"]["slamhive.io/request"])
            runs = {run["metadata"]["uid"]: run for run in objects.of(named("MappingRun"))}
            told = [
                {"uid": one["uid"], "name": one["name"]} | good(asked, rmse=error_of(runs[one["uid"]]))
                for one in asked["runs"]
            ]
            return "".join(encode_all(told))

        lab.cluster.log = log  # type: ignore[union-attr]
        return lab

    return make


def runs_by_trial(runs: list[dict[str, Any]]) -> dict[int, list[int]]:
    """Return the places of the runs that were made, by trial."""
    found: dict[int, list[int]] = {}
    for run in runs:
        trial, place = divmod(int(run["metadata"]["labels"][Label.POINT]), 2)
        found.setdefault(trial, []).append(place)
    return {trial: sorted(places) for trial, places in sorted(found.items())}


def runs_of(op: Operator) -> list[dict[str, Any]]:
    return op.cluster.store.select(Kind.MAPPING_RUN, "lab", Label.SWEEP, "study")


def is_complete(status: dict[str, Any]) -> bool:
    return condition_of(status, "Complete").get("status") == "True"


def has_decided(count: int, status: dict[str, Any]) -> bool:
    return bool(status.get("search", {}).get("decided", 0) >= count)


def sizes(status: dict[str, Any]) -> list[float]:
    return [trial["values"][0] for trial in status["search"]["trials"]]


async def test_a_search_tries_what_is_proposed_and_gives_good_settings_their_further_runs(
    make_search_lab: Callable[..., Lab],
) -> None:
    lab, dice = make_search_lab(), Dice()
    async with lab.operator(sampler=dice, **QUICK) as op:
        lab.apply(search())
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
        runs = runs_by_trial(runs_of(op))
    found, order = status["search"], sorted(range(4), key=lambda n: abs(math.log(sizes(status)[n] / 2)))
    assert dice.asked == list(range(4))
    assert [trial.get("told", 0) for trial in found["trials"]] == [0, 0, 1, 2]
    assert (found["asked"], found["decided"], found["most"], found["spared"]) == (4, 4, 4, 0)
    assert found["best"][0] == {
        "number": order[0],
        "values": [sizes(status)[order[0]]],
        "figures": [pytest.approx(0.15 + abs(math.log(sizes(status)[order[0]] / 2)))],
        "failed": 0.0,
    }
    assert {tuple(places) for places in runs.values()} == {(0,), (0, 1)}
    assert runs[order[0]] == [0, 1]
    count = sum(map(len, runs.values()))
    assert (status["total"], status["succeeded"], status["pending"]) == (count, count, 0)
    assert status["progress"] == "4/4 trials"
    complete = sum(places == [0, 1] for places in runs.values())
    assert condition_of(status, "Complete")["message"] == (
        f"4 settings tried, {complete} of them with all runs"
    )


async def test_trials_may_be_raised_when_all_are_done(make_search_lab: Callable[..., Lab]) -> None:
    lab, dice = make_search_lab(), Dice()
    async with lab.operator(sampler=dice, **QUICK) as op:
        lab.apply(search(trials=1))
        first = await status_of(op, Kind.SWEEP, "study", is_complete)
        lab.patch("sweep", "study", {"spec": {"search": {"trials": 2}}})
        status = await status_of(
            op, Kind.SWEEP, "study", lambda found: is_complete(found) and len(sizes(found)) == 2
        )
    assert dice.asked == [0, 1]
    assert sizes(status)[:1] == sizes(first)


async def test_what_the_archive_knows_is_tried_first_and_not_run_again(
    make_search_lab: Callable[..., Lab], tmp_path: Path
) -> None:
    lab, dice = make_search_lab(), Dice()
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        async with lab.operator(archive, sampler=Dice(), **QUICK) as op:
            lab.apply(search(trials=3))
            first = await status_of(op, Kind.SWEEP, "study", is_complete)
            lab.calls.clear()
        async with lab.operator(archive, sampler=dice, **QUICK) as op:
            again = search(trials=4)
            again["metadata"]["name"] = "again"
            lab.apply(again)
            status = await status_of(op, Kind.SWEEP, "again", is_complete)
    known = [trial for trial in status["search"]["trials"] if trial.get("origin") == "Known"]
    assert sorted(trial["values"][0] for trial in known) == sorted(sizes(first))
    assert dice.asked == [3]
    assert status["search"]["spared"] == status["reused"] >= 3
    assert lab.calls.count(("create", "jobs.batch")) < status["total"]


async def test_a_sampler_that_fails_is_told_and_starts_nothing(make_search_lab: Callable[..., Lab]) -> None:
    lab, dice = make_search_lab(), Dice()
    dice.broken = True
    async with lab.operator(sampler=dice, **QUICK) as op:
        lab.apply(search())
        status = await status_of(op, Kind.SWEEP, "study", lambda found: condition_of(found, "Blocked"))
        assert not runs_of(op)
    told = condition_of(status, "Blocked")
    assert (told["status"], told["reason"]) == ("True", "CannotSearch")
    assert told["message"] == "the sampler TPE: it ran into its limits"


async def test_trials_that_can_t_be_read_are_refused(make_search_lab: Callable[..., Lab]) -> None:
    lab = make_search_lab()
    lab.apply(search())
    lab.patch(
        "sweep", "study", {"status": {"search": {"trials": [{"values": ["a lot"]}]}}}, subresource="status"
    )
    async with lab.operator(sampler=Dice(), **QUICK) as op:
        status = await status_of(op, Kind.SWEEP, "study", lambda found: condition_of(found, "Accepted"))
        assert not runs_of(op)
    assert condition_of(status, "Accepted")["status"] == "False"
    assert "'a lot'" in condition_of(status, "Accepted")["message"]


def test_more_trials_than_a_status_can_hold_are_refused() -> None:
    spec = search(trials=5000)["spec"]
    spec["matrix"] = [
        {"path": "parameters.mode", "values": ["x" * 1000, "y"]},
        {"path": "parameters.size", "range": {"from": 0, "to": 1}},
    ]
    plan = SearchPlan(Sweep.model_validate(search() | {"spec": spec}), FixedCatalog(), strict=False)
    with pytest.raises(
        InputError, match=r"^spec\.search\.trials: 5000 settings of up to .* at most 9\d\d of"
    ):
        require_room(plan, 0)


async def test_what_is_tried_stays_the_same_whenever_the_operator_ends(
    make_search_lab: Callable[..., Lab], tmp_path: Path
) -> None:
    """Its runs are retired to the archive at once, and count all the same."""
    lab, dice = make_search_lab(), Dice()
    lab.apply(search(retention={"runs": 0}))
    asked: list[Dice] = []
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        for decided in (1, 2, 3):
            asked.append(Dice())
            async with lab.operator(archive, sampler=asked[-1], **QUICK) as op:
                await status_of(op, Kind.SWEEP, "study", partial(has_decided, decided))
        async with lab.operator(archive, sampler=dice, **QUICK) as op:
            status = await status_of(op, Kind.SWEEP, "study", is_complete)
            await until(lambda: not runs_of(op), "the runs to be retired")
        records = [*archive.runs(sweep="study")]
        known = archive.sweeps()[0].search
    assert sorted(number for one in (*asked, dice) for number in one.asked) == [0, 1, 2, 3]
    assert len({record.index for record in records}) == len(records) == status["total"]
    assert lab.calls.count(("create", "mappingruns.slamhive.io")) <= len(records)
    assert known is not None
    assert [trial.values for trial in known.trials] == [[size] for size in sizes(status)]


class Killed(BaseException):
    """Exception in the place of `kill -9`."""


class Mortal:
    """A fault hook: the operator dies when its first write to a Sweep, or of a run, was done."""

    def __init__(self) -> None:
        self.dead = False

    def __call__(self, moment: str, verb: str, resource: str) -> None:
        done = f"{verb} {resource}" in {"patch sweeps.slamhive.io/status", "create mappingruns.slamhive.io"}
        self.dead = self.dead or (moment == "after" and done)
        if self.dead:
            raise Killed


def is_over(op: Operator, mortal: Mortal) -> bool:
    body = op.cluster.store.get(Key(Kind.SWEEP, "lab", "study"))
    return mortal.dead or (body is not None and is_complete(body["status"]))


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
async def test_an_operator_that_dies_after_each_write_is_followed_by_one_that_goes_on(
    make_search_lab: Callable[..., Lab],
) -> None:
    lab, dice, deaths = make_search_lab(), Dice(), 0
    tried: list[list[float]] = []
    lab.apply(search(trials=3))
    status: dict[str, Any] = {}
    while not is_complete(status):
        mortal = Mortal()
        async with lab.operator(fault=mortal, sampler=dice, **QUICK) as op:
            await until(partial(is_over, op, mortal), "death, or the end")
        deaths += mortal.dead
        [body] = lab.cluster.of("Sweep", "lab")
        status = body.get("status") or {}
        tried += [sizes(status)] if "search" in status else []
    runs = lab.cluster.of("MappingRun", "lab")
    assert deaths > 3 + len(runs)
    assert all(sizes(status)[: len(one)] == one for one in tried)
    assert set(dice.asked) == {0, 1, 2}
    assert lab.calls.count(("create", "mappingruns.slamhive.io")) <= len(runs)
    assert status["succeeded"] == len(runs) == status["total"]
