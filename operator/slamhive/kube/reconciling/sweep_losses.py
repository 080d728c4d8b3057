# SPDX-License-Identifier: Apache-2.0
"""Runs of a Sweep whose objects are gone: retired here or by another operator, or deleted by hand.

Nobody is kept from deleting anything; what is lost by it is counted and told at the Sweep.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.engine import PointState
from slamhive.kube.reconciling.archiving import at_its_end, in_thread
from slamhive.kube.reconciling.sweep_runs import Finished, is_archive_only, state_of
from slamhive.model.base import plural

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping

    from slamhive.archive import Archive
    from slamhive.kube.api.kinds import Object
    from slamhive.kube.reconciling.sweep_state import SweepMemory

_SHOWN = 3


def are_missing(memory: SweepMemory, runs: Container[int]) -> bool:
    """Tell whether runs are gone that were not deleted here."""
    return any(
        index not in runs and one.run["metadata"]["uid"] not in memory.kept.retired
        for index, one in memory.finished.items()
    )


async def take_out(
    memory: SweepMemory, archive: Archive | None, retention: int, runs: Mapping[int, Object]
) -> list[str]:
    """Count the finished runs whose objects are gone; returns the names of those that others deleted.

    Args:
        memory: what is remembered of the Sweep.
        archive: where finished runs are kept, if anywhere.
        retention: how many of them keep their objects.
        runs: its live runs by point.

    Raises:
        ArchiveAway: the archive does not answer.
    """
    names = []
    gone = [index for index in memory.finished if index not in runs]
    left = sum(state_of(run) is not PointState.ACTIVE for run in runs.values()) if gone else 0
    for index in gone:
        # Their CPU time and results still count: for budgets, and for `best`.
        run = await at_its_end(archive, memory.finished[index].run)
        if memory.search is not None:
            memory.search.note_gone(index, run)
        uid = run["metadata"]["uid"]
        retired, kept = uid in memory.kept.retired, uid in memory.kept.versions
        if not kept and not retired and archive is not None:
            kept = await in_thread(archive.get, uid) is not None
        del memory.finished[index]
        memory.kept.versions.pop(uid, None)
        memory.kept.retired.discard(uid)
        # Another operator deletes none of those that are to keep their objects.
        if retired or (kept and (left >= retention or is_archive_only(run))):
            memory.archived.add(Finished.of(run))
            continue
        memory.deleted[index] = Finished.of(run)
        memory.deletions += 1
        memory.lost |= set() if kept else {index}
        names.append(run["metadata"]["name"])
    return names


async def archived_by_others(
    memory: SweepMemory, archive: Archive | None, uid: str, missing: Iterable[int]
) -> bool:
    """Tell whether the archive has runs that were in flight when they were last seen here.

    Args:
        memory: what is remembered of the Sweep.
        archive: where finished runs are kept, if anywhere.
        uid: the Sweep's.
        missing: points whose runs are gone.

    Raises:
        ArchiveAway: the archive does not answer.
    """
    if archive is None:
        return False
    names = [memory.plan.point(index).name for index in missing]
    return any(record.sweep_uid == uid for record in await in_thread(archive.by_names, names))


def give_up(memory: SweepMemory, index: int) -> str:
    """Count a run in flight that somebody deleted, which cancels it; returns its name."""
    memory.states[index] = PointState.FAILED
    memory.deletions += 1
    memory.lost.add(index)
    return memory.plan.point(index).name


def take_back(memory: SweepMemory, runs: Mapping[int, Object]) -> None:
    """Count each point once: of deleted runs those that are there again count no more."""
    memory.lost -= runs.keys()
    for index in memory.deleted.keys() & runs.keys():
        former = memory.deleted.pop(index).run["metadata"]["uid"]
        if former != runs[index]["metadata"]["uid"]:
            memory.replaced.setdefault(index, set()).add(former)


def remark(memory: SweepMemory) -> str:
    """Return a sentence on the runs that were deleted by hand; empty where nothing is missing."""
    count, lost = memory.deletions, len(memory.lost)
    if not count:
        return f"nothing is left of {plural(lost, 'run')} that were done" if lost else ""
    left = f"nothing is left of {lost}" if lost else "their results are in the archive"
    return f"{plural(count, 'run')} {'were' if count > 1 else 'was'} deleted by hand: {left}"


def announcement(memory: SweepMemory, names: list[str]) -> str:
    """Return a sentence on runs that were found to be deleted by hand just now."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return f"deleted by hand: {', '.join(names[:_SHOWN])}{more}; in all {remark(memory)}"
