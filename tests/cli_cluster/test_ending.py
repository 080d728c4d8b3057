# SPDX-License-Identifier: Apache-2.0
"""``slamhive cancel`` beside an operator, and without one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from testcluster.lab import manifest, run, status_of, sweep, until

from slamhive.kube.api.kinds import Kind, Label, Role
from slamhive.kube.user import cancelling

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest
    from testcluster.lab import Lab

    from conftest import Desk
    from slamhive.kube.operator import Operator


def pods_of_runs(op: Operator) -> list[dict[str, Any]]:
    return op.cluster.store.select(Kind.POD, op.cluster.settings.namespaces[0], Label.ROLE, Role.RUN)


async def test_cancelling_a_sweep_suspends_it_and_ends_its_runs(
    make_lab: Callable[..., Lab], desk: Desk
) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(sweep(sizes=5))
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("running") == 2)
        said = await desk.types("cancel", "study")
        assert said.code == 0
        assert "Sweep study: suspended; 2 in flight cancelled, 3 not started stay pending" in said.text
        status = await status_of(op, Kind.SWEEP, "study", lambda found: found.get("running") == 0)
        assert (status["phase"], status["failed"], status["pending"]) == ("Suspended", 2, 3)
        await until(lambda: not pods_of_runs(op), "the pods to go")
        # The file submitted again lets it go on.
        assert (await desk.types("submit", desk.write(sweep(sizes=5)))).code == 0
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("running") == 2)


async def test_cancelling_a_run_ends_it(make_lab: Callable[..., Lab], desk: Desk) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(run())
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("phase") == "Running")
        assert "MappingRun one: cancelled" in (await desk.types("cancel", "one")).out
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("phase") == "Cancelled")
    again = await desk.types("cancel", "one")
    assert (again.code, again.out.strip()) == (0, "MappingRun one: Cancelled already")


def test_without_an_operator_cancelling_says_what_is_not_sure(
    lab: Lab, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cancelling, "_PATIENCE_SECONDS", 0.0)
    lab.apply(sweep())
    said = desk.type("cancel", "study")
    assert said.code == 0
    assert "no operator has taken notice yet" in said.text
    assert lab.cluster.get("sweep", "study", "-n", lab.namespace)["spec"]["suspend"] is True


async def test_deleting_takes_all_along(make_lab: Callable[..., Lab], desk: Desk) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(sweep())
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("running") == 2)
        said = await desk.types("cancel", "--delete", "study")
        assert "Sweep study: deleted, and with it its runs" in said.text
        kinds = (Kind.SWEEP, Kind.MAPPING_RUN, Kind.JOB, Kind.POD)
        await until(lambda: not any(op.cluster.store.of(kind, lab.namespace) for kind in kinds), "all to go")


def test_an_evaluation_can_only_be_deleted(lab: Lab, desk: Desk) -> None:
    lab.apply(manifest("Evaluation", "again", runs={"names": ["one"]}))
    said = desk.type("cancel", "again")
    assert said.code == 2
    assert "--delete" in said.text
    assert desk.type("cancel", "--delete", "again").code == 0
    assert not lab.cluster.get("evaluations", "-n", lab.namespace)["items"]
