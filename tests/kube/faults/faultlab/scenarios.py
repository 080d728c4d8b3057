# SPDX-License-Identifier: Apache-2.0
"""Scenarios that operators must bring to an end while they are disturbed, and how a test tells."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from testcluster.kwok import Play, run_message
from testcluster.lab import algorithm, condition_of, dataset, manifest, run, sweep

from slamhive.kube.api.kinds import Key, Kind, Label, Object
from slamhive.kube.failing import EVALUATION_ERROR, RECONCILE_ERROR

if TYPE_CHECKING:
    from collections.abc import Callable

    from faultlab.recorder import Recorder

PASSING = (RECONCILE_ERROR, EVALUATION_ERROR)
"""Conditions that tell of trouble on the way, and are no outcome."""


@dataclass(frozen=True)
class Scenario:
    """Objects, how their pods end, and what is to come of it.

    Attributes:
        name: its name.
        objects: what a user applies, beside the catalog.
        play: how pods end.
        retained: how many MappingRuns there are at the end.
        archived: how many rows the archive has at the end; None without an archive.
        evaluated: results that each run that succeeded has at the end.
        victim: what the user deletes now, if anything.
    """

    name: str
    objects: tuple[Object, ...]
    play: Play = field(default_factory=Play)
    retained: int = 0
    archived: int | None = None
    evaluated: int = 0
    victim: Callable[[Recorder, str], Key | None] = lambda _seen, _namespace: None

    @property
    def catalog(self) -> tuple[Object, ...]:
        """Algorithm and Dataset."""
        return algorithm(), dataset()

    def is_over(self, seen: Recorder, namespace: str) -> bool:
        """Tell whether all is done that is to be done, but for the archive."""
        sweeps = seen.alive("sweeps", namespace)
        runs = seen.alive("mappingruns", namespace)
        return (
            all(condition_of(item.get("status") or {}, "Complete").get("status") == "True" for item in sweeps)
            and len(runs) == self.retained
            and all(self._is_settled(item) for item in runs)
            and not [job for job in seen.alive("jobs", namespace) if _role(job) == "evaluate"]
            and not any(_says_that_it_fails(item) for item in (*sweeps, *runs))
        )

    def _is_settled(self, run: Object) -> bool:
        status = run.get("status") or {}
        if status.get("phase") == "Succeeded":
            return len(status.get("results") or ()) == self.evaluated
        return status.get("phase") in {"Failed", "Cancelled"}


def _says_that_it_fails(obj: Object) -> bool:
    """Tell whether an error has yet to be taken back, which the operator does within moments of going on."""
    status = obj.get("status") or {}
    return any(condition_of(status, kind).get("status") == "True" for kind in PASSING)


def _role(job: Object) -> str | None:
    role: str | None = job["metadata"]["labels"].get("slamhive.io/role")
    return role


def _first_when_both_run(seen: Recorder, namespace: str) -> Key | None:
    runs = [run for run in seen.alive("mappingruns", namespace) if _phase(run) == "Running"]
    counted = [(item.get("status") or {}).get("running") for item in seen.alive("sweeps", namespace)]
    if len(runs) < 2 or counted != [2]:
        return None
    [name] = [run["metadata"]["name"] for run in runs if run["metadata"]["labels"][Label.POINT] == "0"]
    return Key(Kind.MAPPING_RUN, namespace, name)


def _phase(run: Object) -> str | None:
    phase: str | None = (run.get("status") or {}).get("phase")
    return phase


SCENARIOS = {
    scenario.name: scenario
    for scenario in (
        Scenario(
            "study",
            (sweep(template={"evaluate": True}, retention={"runs": 1}),),
            retained=1,
            archived=3,
            evaluated=1,
        ),
        Scenario(
            "single",
            (
                run("one", evaluate=True),
                manifest("Evaluation", "rigid", runs={"names": ["one"]}, alignment="SE3"),
            ),
            retained=1,
            evaluated=2,
        ),
        Scenario(
            "stopped",
            (sweep(sizes=2, maxFailures=0),),
            Play(hold=True),
            retained=1,
            victim=_first_when_both_run,
        ),
        Scenario("failing", (sweep(parallelism=1, maxFailures=0),), Play(exit_code=3), retained=1),
        Scenario(
            "faulty",
            (run("one", retries=1),),
            Play(exit_code=137, run=run_message(reason="SystemFault", message="the disk is gone")),
            retained=1,
        ),
    )
}
