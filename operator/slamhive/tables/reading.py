# SPDX-License-Identifier: Apache-2.0
"""Reading an archive as the table of runs, wherever it is."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.grouping import Groups, where_equal
from slamhive.local.home.folder import Home
from slamhive.model.errors import InputError
from slamhive.model.leftout import warn_of
from slamhive.model.results import Outcome
from slamhive.tables import snapshots

if TYPE_CHECKING:
    from slamhive.analysis.frame import Frame
    from slamhive.tables.snapshots import Loaded

REVISION_DIGITS = 16

_REVISED = ("uid", "evaluation", "status", "coverage", "ate.rmse", "usage.cpu.seconds", "finished")


def archive_url(place: str | os.PathLike[str] | None = None) -> str:
    """Return the database URL of an archive.

    Args:
        place: a database URL, a home, or an SQLite file; None for the home that ``$SLAMHIVE_HOME`` names.

    Raises:
        InputError: there is no such place.
    """
    if place is None:
        return Home.from_environment().archive_url
    text = os.fspath(place)
    if "://" in text:
        return text
    path = Path(text).expanduser().absolute()
    if "?" in str(path):  # what follows it in a database URL would be taken for options
        raise InputError(f"{path}: a path with a question mark is not allowed")
    if path.is_dir():
        path /= "archive.sqlite"
    return f"sqlite:///{path}"


def home_of(place: str | os.PathLike[str] | None = None) -> Home:
    """Return the home that has the files of an archive's runs: itself, or the one of ``$SLAMHIVE_HOME``."""
    if place is not None and (folder := Path(os.fspath(place)).expanduser()).is_dir():
        return Home.at(folder)
    return Home.from_environment()


def read_archive(url: str, cache: Path | None = None) -> Frame:
    """Read all runs of an archive, one row a run and evaluation; arguments and errors as ``read_table``."""
    return read_table(url, cache).frame


def read_table(url: str, cache: Path | None = None) -> Loaded:
    """Read all runs and sweeps of an archive; warns of those that can't be read.

    Args:
        url: the archive's database URL.
        cache: folder in which the table is kept for the next time; None to keep none.

    Raises:
        InputError: there is no archive at the URL.
        SystemFault: the database doesn't answer.
    """
    stamp = snapshots.stamp_of(url)
    kept = snapshots.file_for(cache, url) if cache is not None else None
    same = snapshots.unchanged(kept, stamp) if kept is not None else None
    if same is not None:
        return _warned(same, url)
    # A fifth of a second of imports, which a table that is unchanged needs not.
    from slamhive.archive.connection import connect  # noqa: PLC0415
    from slamhive.tables.loading import load  # noqa: PLC0415

    engine = connect(url, read_only=True)
    try:
        before = snapshots.restore(kept) if kept is not None else None
        loaded = load(engine, before, stamp)
        if kept is not None:
            snapshots.keep(kept, loaded, before)
        return _warned(loaded, url)
    finally:
        engine.dispose()


def _warned(loaded: Loaded, url: str) -> Loaded:
    if loaded.left_out:
        from slamhive.archive.connection import shown  # noqa: PLC0415 - as above

        warn_of(loaded.left_out, shown(url))
    return loaded


def with_figure(frame: Frame, metric: str) -> tuple[Frame, list[str]]:
    """Return the runs without those of evaluations that have no such figure: they did not fail in it.

    Args:
        frame: the runs.
        metric: column that is ranked by.
    """
    numbers, tracked = frame.column(metric).floats(), where_equal(frame, "status", Outcome.TRACKED.value)
    kept, notes = np.ones(len(frame), dtype=bool), []
    groups = Groups(frame, ("evaluation",))
    for rows, keys in zip(groups.members(), groups.keys, strict=True):
        if tracked[rows].any() and np.isnan(numbers[rows]).all():
            kept[rows] = False
            notes.append(f"evaluation {keys['evaluation']} has no {metric}: its runs are not shown here")
    return (frame, notes) if kept.all() else (frame.select(kept), notes)


def revision(frame: Frame) -> str:
    """Return 16 digits that differ whenever runs or what was found of them differ."""
    columns = [frame.column(name).tolist() for name in _REVISED]
    lines = sorted(json.dumps(row, default=str) for row in zip(*columns, strict=True))
    return hashlib.sha256("\n".join(lines).encode("utf-8", "replace")).hexdigest()[:REVISION_DIGITS]
