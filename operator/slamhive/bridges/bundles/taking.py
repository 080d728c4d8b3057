# SPDX-License-Identifier: Apache-2.0
"""Taking of runs that somebody else made into a home: told apart by a label, and never taken for own ones.

Their algorithm is called ``NAME @LABEL`` here, their sweep likewise, so that nothing is ever averaged over
own and foreign runs; they have no content hash, so that no run takes over their results. Whether somebody
repeated them here follows from the records (`analysis.derived`).
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.archive import CatalogEntry, SweepRecord
from slamhive.archive.archive import FOREIGN
from slamhive.bridges.bundles.contents import MEASURED
from slamhive.data.files.once import settle
from slamhive.local.home.removed import remove
from slamhive.local.housekeeping.merging import ASIDE
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.results import Origin, OriginKind, Provenance, RunRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.archive import Archive
    from slamhive.bridges.bundles.contents import BundledRun
    from slamhive.bridges.bundles.opening import OpenedBundle
    from slamhive.local.home.folder import Home

_LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")
_OUTPUT = Path("run") / "output"
_UID_DIGITS = 16
BATCH = 200


@dataclass(frozen=True)
class BundleTaken:
    """Counts of runs that came, and of those that were here already."""

    added: int
    known: int


def require_label(
    archive: Archive, label: str, algorithms: Sequence[str], is_same: Callable[[Origin], bool]
) -> None:
    """Refuse a label that is none, or that runs of another origin have.

    Args:
        archive: the archive.
        label: the label.
        algorithms: names that it is put behind.
        is_same: tells whether runs are of the origin that may have it.

    Raises:
        InputError: it can't be one.
    """
    if not _LABEL.fullmatch(label):
        raise InputError(f"{label!r}: a label has letters, digits, - . and _", "label")
    for name in algorithms:
        record = next(archive.runs({"algorithm": foreign_name(name, label)}, limit=1), None)
        if record is not None and record.origin is not None and not is_same(record.origin):
            raise InputError(
                f"{label!r} is taken: {foreign_name(name, label)} is from {record.origin.source}; give "
                "another label to what comes now",
                "label",
            )


def foreign_name(name: str, label: str) -> str:
    """Return the name that something of somebody else has here."""
    return f"{name}{FOREIGN}{label}"


def take_bundle(
    home: Home,
    archive: Archive,
    bundle: OpenedBundle,
    label: str,
    step: Callable[[int, int], None] = lambda *_: None,
) -> BundleTaken:
    """Take the runs of a bundle into a home, with their trajectories.

    Args:
        home: the home.
        archive: its archive.
        bundle: the bundle.
        label: what its algorithms and its sweep are told apart by.
        step: called with the number of runs done, and of all.

    Raises:
        InputError: another bundle has this label.
        SystemFault: the disk refuses.
    """
    names = sorted({run.record.spec["algorithmRef"]["name"] for run in bundle.runs.values()})
    require_label(archive, label, names, lambda origin: origin.sha256 == bundle.sha256)
    study = bundle.study
    sweep = SweepRecord(
        uid=f"{bundle.sha256[:_UID_DIGITS]}-study",
        name=foreign_name(study.name, label),
        spec=study.sweep,
        evaluation=study.evaluation,
        labels={"source": "bundle"},
    )
    archive.put_sweep(sweep)
    known = {record.uid for record in archive.runs({"sweep_uid": sweep.uid})}
    entries = {one.manifest: _entry(bundle, one.manifest, label) for one in study.algorithms}
    entries |= {one.manifest: _entry(bundle, one.manifest, None) for one in study.datasets}
    batch: list[tuple[RunRecord, CatalogEntry | None, CatalogEntry | None]] = []
    added = 0
    for number, run in enumerate(bundle.runs.values()):
        step(number, len(bundle.runs))
        record = _foreign_record(home, bundle, run, label, sweep)
        if record.uid in known:
            continue
        # Files before the record: what a record says to be there is there.
        place_files(home, Path(record.folder or ""), partial(bundle.file.place_run, run.record.name))
        batch.append((record, entries[run.algorithm], entries[run.dataset]))
        added += 1
        if len(batch) == BATCH:
            archive.put_used(batch)
            batch = []
    if batch:
        archive.put_used(batch)
    return BundleTaken(added, len(bundle.runs) - added)


def place_files(home: Home, folder: Path, place: Callable[[Path], object]) -> None:
    """Put the files of a run where those of own runs are, whole or not at all.

    Args:
        home: the home.
        folder: the run's folder.
        place: writes them into a folder.

    Raises:
        SystemFault: the disk refuses.
    """
    aside = home.path / ASIDE / f"import-{os.getpid()}"
    if folder.exists():
        return
    try:
        if aside.exists():
            remove(aside)
        output = aside / _OUTPUT
        output.mkdir(parents=True)
        place(output)
        settle(aside, read_only=False)
        folder.parent.mkdir(parents=True, exist_ok=True)
        aside.rename(folder)
    except OSError as error:
        raise SystemFault(f"{error.filename or folder}: {error.strerror or error}") from error


def _entry(bundle: OpenedBundle, manifest: str, label: str | None) -> CatalogEntry:
    found = CatalogEntry.of(bundle.manifest(manifest))
    return found if label is None else found.replace(name=foreign_name(found.name, label))


def _foreign_record(
    home: Home, bundle: OpenedBundle, run: BundledRun, label: str, sweep: SweepRecord
) -> RunRecord:
    record, study = run.record, bundle.study
    name = record.spec["algorithmRef"]["name"]
    folder = home.path / "runs" / f"{study.name}@{label}" / record.name
    origin = Origin(
        kind=OriginKind.BUNDLE,
        label=label,
        source=f"{study.title} ({bundle.file.title})",
        sha256=bundle.sha256,
        algorithm=name,
        content_hash=record.provenance.content_hash,
        subject=run.subject.as_json() if run.subject else None,
    )
    trajectory = record.trajectory
    if trajectory is not None:
        trajectory = trajectory.replace(path=str(folder / _OUTPUT / MEASURED[0]))
    provenance: Provenance = record.provenance.replace(content_hash=None, reused_from=None)
    spec: dict[str, Any] = {**record.spec, "algorithmRef": {"name": foreign_name(name, label)}}
    return record.replace(
        uid=f"{bundle.sha256[:_UID_DIGITS]}-{record.uid}",
        sweep=sweep.name,
        sweep_uid=sweep.uid,
        namespace=None,
        cluster=None,
        spec=spec,
        provenance=provenance,
        trajectory=trajectory,
        folder=str(folder) if trajectory is not None else None,
        note=None,
        tags=[],
        noted=None,
        origin=origin,
    )
