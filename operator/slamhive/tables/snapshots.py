# SPDX-License-Identifier: Apache-2.0
"""The table of columns on disk, so that a start needs not read 80,000 documents again.

It is a cache: it says of each run what the run looked like when it was read, and only what looks the same in
the database is taken from it. A file that is damaged, foreign or of another version is left alone.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import time
import zipfile
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from slamhive import __version__
from slamhive.analysis.columns import Column, ColumnKind
from slamhive.analysis.compact.growing import joined
from slamhive.analysis.compact.shapes import loads
from slamhive.analysis.compact.texts import PackedTexts
from slamhive.analysis.derived import SweepVersion, with_derived
from slamhive.analysis.frame import DERIVED, Frame
from slamhive.model.leftout import LeftOut
from slamhive.tables.marks import RunMarks

VERSION = 11
_SETTLED_NANOSECONDS = 2 * 10**9
LEAST_ROWS = 5000
"""Rows from which on a cache is worth its place where it can't spare the database itself."""


@dataclass(frozen=True)
class Loaded:
    """The archive as it was at one moment.

    Attributes:
        frame: one row a run and evaluation, in the order of storing.
        marks: what each run looked like in short.
        sweeps: the versions of sweeps; None where the columns that follow from them are missing.
        stamp: what the database's files looked like then; None where that says nothing.
        left_out: rows that can't be read.
    """

    frame: Frame = field(default_factory=lambda: Frame({}, 0))
    marks: RunMarks = field(default_factory=lambda: RunMarks.joined([]))
    sweeps: tuple[SweepVersion, ...] | None = None
    stamp: tuple[int, ...] | None = None
    left_out: tuple[LeftOut, ...] = ()


def derived(before: Loaded, sweeps: tuple[SweepVersion, ...]) -> Loaded:
    """Return the same runs with what follows from other versions of their sweeps."""
    frame = before.frame
    columns = {name: frame.column(name) for name in frame.stored}
    found = with_derived(columns, len(frame), sweeps).declaring(frame.declared)
    return replace(before, frame=found, sweeps=sweeps)


def file_for(folder: Path, url: str) -> Path:
    """Return the cache's file of an archive."""
    return folder / f"dashboard-{hashlib.sha256(url.encode()).hexdigest()[:16]}.npz"


def stamp_of(url: str) -> tuple[int, ...] | None:
    """Return a stamp of an SQLite database's files; None where it can't tell whether they changed.

    Times of files are coarse: a file that was written just now may be written again at the same time.
    """
    path = url.removeprefix("sqlite:///")
    if path == url:
        return None
    found: list[int] = []
    for name in (path, f"{path}-wal"):
        try:
            status = os.stat(name)  # noqa: PTH116
        except FileNotFoundError:
            found += [0, 0]
            continue
        except OSError:
            return None
        written = status.st_mtime_ns if status.st_size else 0  # readers make an empty log and remove it
        found += [status.st_size, written]
        if time.time_ns() - written < _SETTLED_NANOSECONDS:
            return None
    return tuple(found)


def save(path: Path, loaded: Loaded) -> None:
    """Write a table; a disk that refuses is no fault."""
    frame = loaded.frame
    arrays: dict[str, Any] = {"ids": loaded.marks.ids, "marks": loaded.marks.marks}
    described = []
    for number, name in enumerate(name for name in frame.stored if name not in DERIVED):
        column = frame.column(name)
        arrays[f"c{number}"] = column.held
        values = column.values.data if isinstance(column.values, PackedTexts) else column.values
        is_array = isinstance(values, np.ndarray)
        if column.is_coded:
            # By themselves, so that a start needs memory for the texts of one column at a time.
            arrays[f"v{number}"] = values if is_array else _text_of(values)
        described.append(
            {"name": name, "kind": str(column.kind), "array": is_array, "coded": column.is_coded}
        )
    head = {
        "version": VERSION,
        "slamhive": __version__,
        "rows": len(frame),
        "columns": described,
        "sweeps": loaded.sweeps,
        "declared": frame.declared,
        "stamp": loaded.stamp,
        "leftOut": loaded.left_out,
    }
    arrays["head"] = _text_of(head)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, aside = tempfile.mkstemp(dir=path.parent, prefix=".dashboard-", suffix=".npz")
        try:
            with os.fdopen(descriptor, "wb") as stream:
                np.savez(stream, **arrays)
            Path(aside).replace(path)
        except BaseException:
            with suppress(OSError):
                Path(aside).unlink()
            raise


def keep(path: Path, loaded: Loaded, before: Loaded | None) -> bool:
    """Write a table for the next start, if that saves it work; tells whether it was.

    It saves work where the next start need not look for changes at all, and in a large table where much of it
    is news.

    Args:
        path: the cache's file.
        loaded: the table.
        before: what the file holds.
    """
    known = before.marks if before is not None else RunMarks.joined([])
    settled = loaded.stamp is not None and (before is None or loaded.stamp != before.stamp)
    if not settled and len(loaded.frame) < LEAST_ROWS:
        return False
    if not settled and len(loaded.marks.changed_since(known)) <= len(loaded.marks) // 20:
        return False
    save(path, loaded)
    return True


def unchanged(path: Path, stamp: tuple[int, ...] | None) -> Loaded | None:
    """Return the table in a file if it is what the archive holds now.

    The database is not asked, and its library, which takes longer to be imported than a list to be printed,
    is not needed.

    Args:
        path: the cache's file.
        stamp: what the database's files look like.
    """
    if stamp is None:
        return None
    kept = _read(path)
    if kept is None:
        return None
    table, sweeps = kept
    return derived(table, sweeps) if table.stamp == stamp and sweeps is not None else None


def restore(path: Path) -> Loaded | None:
    """Return the table in a file; None where there is none that can be used."""
    kept = _read(path)
    return None if kept is None else kept[0]


def _read(path: Path) -> tuple[Loaded, tuple[SweepVersion, ...] | None] | None:
    """Return the table in a file without what follows from sweeps, and these."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            head = loads(arrays["head"].tobytes())
            if head["version"] != VERSION or head["slamhive"] != __version__:
                return None
            columns = {}
            for number, item in enumerate(head["columns"]):
                values = arrays[f"v{number}"] if item["coded"] else None
                columns[str(item["name"])] = _column(item, arrays[f"c{number}"], values, int(head["rows"]))
            marks = RunMarks(arrays["ids"], arrays["marks"])
            told, declared = head["sweeps"], dict(head["declared"])
            left_out = tuple(LeftOut(*one) for one in head["leftOut"])
            sweeps = None if told is None else tuple(SweepVersion(*one) for one in told)
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
        return None
    frame = Frame(columns, int(head["rows"]), declared=declared)
    stamp = tuple(head["stamp"]) if head["stamp"] else None
    return Loaded(frame, marks, stamp=stamp, left_out=left_out), sweeps


def _text_of(value: Any) -> Any:
    return np.frombuffer(json.dumps(value).encode(), dtype=np.uint8)


def _column(item: dict[str, Any], array: Any, values: Any, rows: int) -> Column:
    kind = ColumnKind(item["kind"])
    if array.shape != (rows,):
        raise ValueError(f"a column's shape {array.shape} is not ({rows},)")
    if values is None:
        return Column(kind, joined([array.astype(np.float64, copy=False)]), np.empty(0, dtype=np.int32))
    if not item["array"]:
        values = tuple(loads(values.tobytes()))
    elif not kind.is_numeric:
        values = PackedTexts(joined([values]))
    if rows and not -1 <= int(array.min()) <= int(array.max()) < len(values):
        raise ValueError("a code without a value")
    return Column(kind, np.empty(0), array, values)
