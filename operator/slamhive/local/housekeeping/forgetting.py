# SPDX-License-Identifier: Apache-2.0
"""Forgetting of runs: what goes of those that were chosen, what is kept and why, and its removal.

Records stay unless they are asked for too: the numbers are in the archive, not in the files. A folder goes
only where every run that refers to it was chosen, as a run that took over an equal run's result has that
run's folder. Whoever calls this is at work in the home
alone (`alone`).
"""

from __future__ import annotations

from collections import defaultdict
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from slamhive.local.home.extent import DiskTally, Extent, total
from slamhive.local.home.folder import lock
from slamhive.local.home.removed import leftovers_in, remove, remove_files, removed_from, run_parts
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.results import IMPORTED

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from pathlib import Path

    from slamhive.archive import Archive
    from slamhive.local.home.folder import Home

_BATCH = 500


class ArchivedRun(NamedTuple):
    """A run that the archive knows.

    Attributes:
        uid: its identity.
        name: its name.
        sweep: name of its sweep.
        folder: of its files, as its record has it.
        source: the label that says where it was imported from.
    """

    uid: str
    name: str
    sweep: str | None
    folder: str | None
    source: str | None = None


@dataclass(frozen=True)
class Going:
    """A run of which something goes.

    Attributes:
        run: the run.
        folder: whose files go with it; None where none do, or another run of the selection has it.
        extent: what that gives back.
    """

    run: ArchivedRun
    folder: Path | None
    extent: Extent


@dataclass(frozen=True)
class Forgetting:
    """Plan for forgetting chosen runs: which of them go, and how many stay.

    Attributes:
        going: the runs.
        records: whether their records go too.
        shared: what those files take that stay as runs that were not chosen refer to them, folder by folder.
        busy: chosen runs that stay, as a killed slamhive may have left processes in their folders.
        imported: chosen runs whose files are where they were imported from, and stay.
    """

    going: tuple[Going, ...]
    records: bool
    shared: tuple[Extent, ...] = ()
    busy: int = 0
    imported: int = 0

    @property
    def extent(self) -> Extent:
        """Return the room that it gives back."""
        return total(one.extent for one in self.going)

    @property
    def by_sweep(self) -> Mapping[str | None, tuple[int, Extent]]:
        """Return the number of runs that go and the room that they give back, by sweep, the largest first."""
        found: dict[str | None, tuple[int, Extent]] = {}
        for one in self.going:
            count, extent = found.get(one.run.sweep, (0, Extent()))
            found[one.run.sweep] = count + 1, extent + one.extent
        order = sorted(found.items(), key=lambda item: (-item[1][1].size, -item[1][0], str(item[0])))
        return dict(order)

    def restricted(self, uids: Collection[str]) -> Forgetting:
        """Return the same of some runs alone."""
        return replace(self, going=tuple(one for one in self.going if one.run.uid in uids))


@contextmanager
def alone(home: Home, what: str) -> Iterator[None]:
    """Keep others from running, and from fetching files, while something is removed or renamed.

    All that removes or renames things asks here whether anybody is at work.

    Args:
        home: the home.
        what: the command, for those that have to wait for it.

    Raises:
        InputError: a runner is at work in the home, or a fetch.
    """
    with home.exclusive(what), lock(home.path / "fetch.lock", wait=False) as held:
        if held is None:
            raise InputError(f"slamhive fetch --files is at work in {home.path}; wait for it")
        yield


def plan_forgetting(
    home: Path,
    runs: Iterable[ArchivedRun],
    chosen: Collection[str],
    *,
    records: bool = False,
    larger: float | None = None,
) -> Forgetting:
    """Return the plan of all that goes when some runs are forgotten.

    Args:
        home: the home.
        runs: all that the archive knows.
        chosen: UIDs of those to be forgotten.
        records: whether their records go too.
        larger: only those whose files take more bytes than this.
    """
    by_folder, elsewhere = _by_folder(home, runs)
    without = [run for run in elsewhere if run.uid in chosen]
    going: list[Going] = []
    shared: list[Extent] = []
    busy, tally = 0, DiskTally(freed=True)
    for folder, users in by_folder.items():
        mine = [run for run in users if run.uid in chosen]
        if not mine:
            continue
        # A removal that was interrupted has left its note, and files: those are still to go.
        gone = removed_from(folder) is not None and not leftovers_in(folder)
        taken = Extent() if gone else DiskTally().of(folder)
        if larger is not None and taken.size <= larger:
            continue
        # Removing files below a program that still writes would only have it make them anew.
        if is_left_behind(folder):
            busy += len(mine)
            continue
        own = len(mine) == len(users)
        if not own and not gone:
            shared.append(taken)
        if records or (own and not gone):
            freed = tally.of(folder) if own and not gone else Extent()
            going.append(Going(mine[0], folder if own else None, freed))
            # What the folder gives back is counted once, however many runs refer to it.
            going += [Going(run, None, Extent()) for run in mine[1:]]
    # Runs without files are smaller than any size that is asked for.
    if records and larger is None:
        going += [Going(run, None, Extent()) for run in without]
    imported = sum(run.source == IMPORTED for run in without)
    return Forgetting(tuple(going), records, tuple(shared), busy, imported)


def forget(
    home: Home, archive: Archive, plan: Forgetting, step: Callable[[int], None] = lambda _: None
) -> None:
    """Remove what a plan names; one that is interrupted is gone on with by the next call.

    A run's files go before its record, and the note in their place after it: whenever this ends, a record
    has its files, or a note that says when they went.

    Args:
        home: the home, in which the caller is alone.
        archive: its archive.
        plan: what goes.
        step: called with the number of runs done so far.

    Raises:
        SystemFault: the disk refuses.
    """
    removed: list[Going] = []
    for number, one in enumerate(plan.going, 1):
        if one.folder is not None and one.folder.is_dir():
            remove_files(one.folder, one.extent.size)
        if plan.records:
            removed.append(one)
            # In batches, as each is a transaction that has to reach the disk.
            if len(removed) >= _BATCH:
                _remove_records(archive, removed)
        step(number)
    _remove_records(archive, removed)
    remove_empty(home.path / "runs")


def _remove_records(archive: Archive, going: list[Going]) -> None:
    archive.remove_runs(one.run.uid for one in going)
    for one in going:
        if one.folder is not None and one.folder.is_dir():
            try:
                remove(one.folder)
            except OSError as error:
                raise SystemFault(f"{one.folder}: {error.strerror or error}") from error
    going.clear()


def remove_empty(runs: Path) -> None:
    """Remove folders of sweeps that hold no run any more."""
    for folder in runs.iterdir() if runs.is_dir() else ():
        with suppress(OSError):  # there is something in it, or it is none
            folder.rmdir()


def is_left_behind(folder: Path) -> bool:
    """Tell whether a slamhive that was killed may have left processes at work in a run's folder."""
    return (folder / "process.json").exists() and not (folder / "summary.json").exists()


def _by_folder(
    home: Path, runs: Iterable[ArchivedRun]
) -> tuple[dict[Path, list[ArchivedRun]], list[ArchivedRun]]:
    """Return the folders in the home with the runs that refer to each, and the runs without one."""
    by_folder: dict[Path, list[ArchivedRun]] = defaultdict(list)
    without = []
    for run in runs:
        folder = _folder(home, run)
        if folder is None:
            without.append(run)
        else:
            by_folder[folder].append(run)
    return by_folder, without


def _folder(home: Path, run: ArchivedRun) -> Path | None:
    """Return a run's folder in the home, None where it has none there."""
    parts = run_parts(run.folder)
    if parts is None or run.source == IMPORTED:
        return None
    folder = home.joinpath("runs", *parts)
    return folder if folder.is_dir() else None
