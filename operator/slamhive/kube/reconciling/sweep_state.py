# SPDX-License-Identifier: Apache-2.0
"""In-memory state of a Sweep: its plan, and the state of each point.

All of it can be made again from the Sweep's spec and status, its live runs and the archive.
"""

from __future__ import annotations

import asyncio
from array import array
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import islice
from typing import TYPE_CHECKING

from slamhive.archive import SweepRecord
from slamhive.contract.heap import return_memory
from slamhive.engine import PointState
from slamhive.kube.api.encoding import encode
from slamhive.kube.api.kinds import annotations_of
from slamhive.kube.reconciling.archiving import KeptRuns, in_thread
from slamhive.kube.reconciling.sweep_runs import Finished, SweepTally, decode_points, point_of, state_of
from slamhive.kube.reconciling.sweep_search import SearchMemory, read_trials, require_room, written_trials
from slamhive.kube.status import moment
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.model.results import Phase
from slamhive.model.status import LIST_BYTES, AxisSelection, SweepStatus, trial_field
from slamhive.plan import FixedCatalog, Plan, SearchPlan, plan_of, plan_problems
from slamhive.plan.catalog import select

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.archive import Archive
    from slamhive.kube.api.kinds import Object
    from slamhive.model.search import Trial
    from slamhive.model.status import SweepShare
    from slamhive.model.sweep import Axis, Sweep

_READ_AT_ONCE = 500
_KINDS = {"algorithm": "algorithm", "dataset": "dataset"}


@dataclass
class SweepMemory:
    """A Sweep that was accepted.

    Attributes:
        plan: its points.
        order: indices in the order in which they are to be started.
        states: state of each point, one a byte.
        selected: what each selector of its matrix chose.
        remarks: which of its settings have no effect on some recordings, a sentence a line.
        cursor: position in ``order`` before which no point is pending.
        archived: figures over finished runs whose objects are gone.
        started_at: when its first run was started, s since 1970.
        looked_at: when it was last looked at.
        written_at: when its status was last written.
        finished: its finished runs that were there when it was last looked at, by point.
        points: the states of its points as they were last written or read.
        kept: its runs that are in the archive.
        deletions: how many of its runs were deleted by others.
        deleted: of these the finished ones, by point, unless that was done again.
        replaced: UIDs of runs that were deleted and are done again, by point: their records go then.
        lost: points that are done, of whose runs neither object nor record is left.
        search: what is remembered of its search, where it is one; ``order`` is empty then.
        share: what it says of its share of the cluster.
    """

    plan: Plan
    order: Sequence[int]
    states: bytearray
    selected: list[AxisSelection]
    archived: SweepTally
    remarks: str = ""
    started_at: float | None = None
    cursor: int = 0
    looked_at: float = 0.0
    written_at: float = 0.0
    finished: dict[int, Finished] = field(default_factory=dict)
    points: str | None = None
    kept: KeptRuns = field(default_factory=KeptRuns)
    deletions: int = 0
    deleted: dict[int, Finished] = field(default_factory=dict)
    replaced: dict[int, set[str]] = field(default_factory=dict)
    lost: set[int] = field(default_factory=set)
    search: SearchMemory | None = None
    share: SweepShare | None = None

    def note(self, index: int, run: Object) -> None:
        """Note what is seen of a point's run now."""
        known = self.finished.get(index)
        # The store has the same object until there is a newer one: hundreds are looked at each time.
        if known is None or known.run is not run:
            self.states[index] = state_of(run)
            self.finished.pop(index, None)
            if self.states[index] != PointState.ACTIVE:
                self.finished[index] = Finished.of(run)

    @property
    def most_runs(self) -> int:
        """Return the number of runs at most."""
        return self.search.plan.most_runs if self.search else len(self.plan)


def choose(sweep: Sweep, catalog: FixedCatalog, status: SweepStatus) -> list[AxisSelection]:
    """Return the choice of each selector of a matrix; one that a status says was made before stays.

    Without that, an Algorithm added later would give every point another meaning.
    """
    before = {item.axis: item for item in status.selected}
    chosen = []
    for number, axis in enumerate(sweep.spec.matrix):
        if axis.selector is not None:
            kind = (axis.path or "").removesuffix("Ref.name")
            names = select(catalog, _KINDS.get(kind, kind), axis.selector.match_labels)
            chosen.append(before.get(number) or AxisSelection(axis=number, names=names))
    return chosen


def fixed(sweep: Sweep, selected: list[AxisSelection]) -> Sweep:
    """Return a Sweep with the values that its selectors chose in their places."""
    names = {item.axis: item.names for item in selected}

    def axis(number: int, given: Axis) -> Axis:
        if not names.get(number):
            return given
        return given.replace(selector=None, values=names[number])

    matrix = [axis(number, given) for number, given in enumerate(sweep.spec.matrix)]
    return sweep.replace(spec=sweep.spec.replace(matrix=matrix))


async def remember(
    sweep: Sweep,
    body: Object,
    catalog: FixedCatalog,
    live: list[Object],
    archive: Archive | None,
    *,
    accepted: bool,
    cluster: str | None = None,
) -> SweepMemory:
    """Return the memory of a Sweep, made from what is written down of it.

    Args:
        sweep: the Sweep.
        body: the same as the API holds it, with its status.
        catalog: Algorithms and Datasets of its namespace.
        live: its live runs.
        archive: where finished runs go.
        accepted: whether it was accepted before; then the catalog isn't checked again.
        cluster: what tells its cluster from others.

    Raises:
        InputError: the plan is wrong, or the catalog does not allow it; one sentence a line.
        ArchiveAway: the archive does not answer.
    """
    status = SweepStatus.of(body)
    selected = choose(sweep, catalog, status)
    if (size := len(encode([item.as_json() for item in selected]))) > LIST_BYTES:
        raise InputError(
            f"spec.matrix: the names that its selectors choose have {size} bytes, a Sweep can note "
            f"{LIST_BYTES}: divide it"
        )

    chosen, searching = fixed(sweep, selected), sweep.spec.search.is_search
    tried = read_trials(written_trials(body))
    if searching and archive is not None and not tried:
        tried = await in_thread(_tried, archive, sweep.metadata.uid or "")  # the status was lost

    def lay_out() -> tuple[Plan, list[int], str]:
        plan = plan_of(chosen, catalog, tried)
        if isinstance(plan, SearchPlan):
            require_room(plan, size)
        shown = plan.probing() if isinstance(plan, SearchPlan) else plan
        # What was accepted once goes on: a catalog that has changed since must not stop a Sweep halfway.
        problems = [] if accepted else plan_problems(shown)
        if problems:
            raise InputError("\n".join(problems))
        return plan, [] if searching else plan.start_order(), "\n".join(shown.remarks())

    # In a thread: a plan of tens of thousands of points takes long enough for probes and watches to suffer.
    plan, order, remarks = await asyncio.to_thread(lay_out)
    search = None
    if isinstance(plan, SearchPlan):
        search = SearchMemory(plan, [trial_field(one) for one in tried])
    memory = SweepMemory(
        plan=plan,
        order=array("I", order),  # a tenth of a list's memory
        states=decode_points(status.points, len(plan)),
        selected=selected,
        archived=SweepTally(best=status.best),
        remarks=remarks,
        started_at=moment(status.start_time),
        points=status.points,
        deletions=status.deleted or 0,
        search=search,
    )
    there = bytearray(len(memory.states))  # 1 for each point of which there is an object or a record
    for run in live:
        # Another operator may remove them before the first look: what is noted here is missed then.
        if (index := point_of(run)) is not None and index < len(memory.states):
            memory.note(index, run)
            there[index] = 1
    if archive is not None:
        await in_thread(_recall, sweep, archive, live, memory, cluster, there=there)
    memory.lost = {
        index
        for index, state in enumerate(memory.states)
        if state >= PointState.SUCCEEDED and not there[index]
    }
    return_memory()
    return memory


def _tried(archive: Archive, uid: str) -> list[Trial]:
    """Return the trials that the archive knows of a search; none where it doesn't know the Sweep."""
    try:
        return archive.change_search(uid, lambda known: known).trials
    except UnknownNameError:
        return []


def _recall(
    sweep: Sweep,
    archive: Archive,
    live: list[Object],
    memory: SweepMemory,
    cluster: str | None,
    *,
    there: bytearray,
) -> None:
    """Take from the archive what became of the runs whose objects are gone, and note that they are there."""
    uid = sweep.metadata.uid or ""
    archive.put_sweep(
        SweepRecord(
            uid=uid,
            name=sweep.name,
            namespace=sweep.metadata.namespace,
            cluster=cluster,
            labels=sweep.metadata.labels,
            spec=sweep.spec.as_json(),
            created=datetime.now(UTC),
            evaluation=sweep.spec.evaluation.as_json(),
        )
    )
    present = {run["metadata"]["uid"]: run for run in live}
    points = {point_of(run) for run in live}
    without = set(present)
    for run, point in archive.finished(uid):
        if run in present:
            # What was measured or said of it later than it was archived is still to be written there.
            said = point.remarks.covers(annotations_of(present[run]))
            if said and len(present[run]["status"].get("results") or ()) == point.results:
                memory.kept.add(present[run])
        elif point.index is not None and point.index < len(memory.states):
            # A run that was deleted and is done again counts once.
            if point.index in points:
                memory.replaced.setdefault(point.index, set()).add(run)
                without.add(run)
            else:
                succeeded = point.phase is Phase.SUCCEEDED
                memory.states[point.index] = PointState.SUCCEEDED if succeeded else PointState.FAILED
                there[point.index] = 1
    if memory.search is not None:
        gone = {index for index, is_there in enumerate(there) if is_there} - points
        records = archive.runs({"sweep_uid": uid})
        while some := [*islice(records, _READ_AT_ONCE)]:
            memory.search.note({one.index: one for one in some if one.index in gone})
    totals = archive.totals(uid, without)
    memory.archived.reused, memory.archived.evaluated = totals.reused, totals.evaluated
    memory.archived.cpu_seconds = totals.cpu_seconds
