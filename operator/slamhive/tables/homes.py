# SPDX-License-Identifier: Apache-2.0
"""Several homes in one table: those of colleagues and other machines, read beside one's own.

Rows are told apart by what they are, never by their names. A run that stands in several homes (one UID, one
content) is there once. A name that means something else in another home (an algorithm, a dataset or a sweep
of other content) gets that home's label there, as in ``icp @anna``, and so does a UID that two runs have:
what has one name in the table is one thing. What is superseded was found out home by home. Nothing is
written to other homes, and none of their locks is taken.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import Column
from slamhive.analysis.flattening import MAX_COLUMNS, bound, stack
from slamhive.analysis.frame import Frame
from slamhive.local.home.folder import Home
from slamhive.model.errors import InputError, SlamHiveError
from slamhive.tables.reading import archive_url, read_archive

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from slamhive.archive import Cost

OWN = "here"
"""The label of one's own home."""

COLUMN = "home"
"""The column that says which home a row is of, where there are several."""

VARIABLE = "SLAMHIVE_ALSO"
_LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")
_NAMED = (("algorithm", "algorithm.version"), ("dataset", "dataset.version"), ("sweep", "sweep.uid"))
_SHOWN = 3
_SAME = ("uid", "provenance.contentHash", "evaluation")


@dataclass(frozen=True)
class Beside:
    """Another home that is read beside one's own.

    Attributes:
        label: what it is called in tables.
        url: of its archive.
        path: its folder; None for a database.
    """

    label: str
    url: str
    path: Path | None

    @property
    def home(self) -> Home | None:
        """Return it as a home with files; None for a database."""
        return Home(self.path, self.url) if self.path is not None else None


def homes_beside(own: Home, places: Sequence[str] | None, argument: str = "also") -> list[Beside]:
    """Return the other homes that are meant.

    Args:
        own: one's own, which is not another one.
        places: each a home, an archive's file or a database URL, or LABEL= and that; None for those that
            ``$SLAMHIVE_ALSO`` names, with commas between them.
        argument: what gave the places.

    Raises:
        InputError: there is no such place, or two have one label.
    """
    told = ("", argument) if places is not None else (f"{VARIABLE}: ", "")
    if places is None:
        places = [one for one in os.environ.get(VARIABLE, "").split(",") if one.strip()]
    found: dict[str, Beside] = {}
    for text in places:
        if text.strip().rpartition("=")[2] == str(own.path):
            continue
        one = _beside(text.strip(), *told)
        if one.url in {own.archive_url, *(known.url for known in found.values())}:
            continue
        if one.label in {OWN, *found}:
            raise InputError(
                f"{told[0]}{text}: another home is called {one.label!r} already: name it by LABEL=PATH",
                told[1],
            )
        found[one.label] = one
    return list(found.values())


def read_homes(own: Home, others: Iterable[Beside], *, keep: bool = True) -> Frame:
    """Read the runs of several homes, one row a run and evaluation.

    Args:
        own: one's own home; one without an archive has no runs.
        others: the other ones.
        keep: whether large tables are kept in one's own home for the next time.

    Raises:
        InputError: there is no archive, or one of another version.
        SystemFault: a database doesn't answer.
    """
    cache = own.path / "cache" if keep else None
    frames = [(OWN, Frame({}, 0) if own.missing_archive else read_archive(own.archive_url, cache))]
    for one in others:
        try:
            frames.append((one.label, read_archive(one.url, cache)))
        except SlamHiveError as error:
            raise type(error)(f"home {one.label}: {error}") from None
    return together(frames)


def together(frames: Sequence[tuple[str, Frame]]) -> Frame:
    """Return the tables of several homes as one.

    Args:
        frames: each with the home's label, one's own first.
    """
    parts: list[tuple[dict[str, Column], int]] = []
    known: dict[str, dict[str, set[str]]] = {name: {} for name, _ in _NAMED}
    seen: set[tuple[Any, ...]] = set()
    uids: dict[str, str | None] = {}
    last = 0.0
    declared: dict[str, Mapping[str, str]] = {}
    for label, whole in frames:
        frame = _without(whole, seen)
        columns = {name: frame.glance(name) for name in frame.stored}
        if not len(frame):
            continue
        for name, version in _NAMED:
            columns[name] = _told_apart(frame, name, version, label, known[name])
        columns["uid"] = _own_uids(frame, label, uids)
        ids = columns["id"].floats() + last
        columns["id"] = Column.of_numbers(ids, columns["id"].kind)
        last = float(ids.max())
        columns[COLUMN] = Column.of_codes(np.zeros(len(frame), dtype=np.int32), (label,))
        for name, units in whole.declared.items():
            declared.setdefault(name, units)
            declared[told_name(name, label)] = units
        parts.append((columns, len(frame)))
    bound(parts, parts[0][0] if parts else (), MAX_COLUMNS)
    columns, length = stack(parts) if parts else ({}, 0)
    return Frame(columns, length, declared=declared)


def costs_together(homes: Sequence[tuple[str, Sequence[Cost]]]) -> list[Cost]:
    """Return the costs of several homes' runs, each run once, names told apart as in tables.

    Args:
        homes: each with its label, one's own first.
    """
    met: set[tuple[str, str | None]] = set()
    known: dict[tuple[str, str], set[str]] = {}
    found: list[Cost] = []
    for label, costs in homes:
        fresh = [cost for cost in costs if (cost.uid, cost.content_hash) not in met]
        met.update((cost.uid, cost.content_hash) for cost in fresh)
        here: dict[tuple[str, str], set[str]] = {}
        for cost in fresh:
            for part, hashed in (("algorithm", cost.algorithm_hash), ("dataset", cost.dataset_sha256)):
                if hashed is not None:
                    here.setdefault((part, getattr(cost, part)), set()).add(hashed)
        strange = {key for key, hashes in here.items() if key in known and not hashes & known[key]}
        for cost in fresh:
            algorithm, dataset = (
                told_name(name, label) if (part, name) in strange else name
                for part, name in (("algorithm", cost.algorithm), ("dataset", cost.dataset))
            )
            found.append(cost._replace(algorithm=algorithm, dataset=dataset))
        for key, hashes in here.items():
            known.setdefault(key, hashes)
    return found


def uid_in(uid: str, labels: Collection[str]) -> tuple[str, str | None]:
    """Return a UID of the table as its home knows it, and that home's label; None where it could be any."""
    plain, _, label = uid.rpartition("~")
    return (plain, label) if plain and label in labels else (uid, None)


def told_name(name: str, label: str) -> str:
    """Return the name of something that means something else in a home."""
    return f"{name} @{label}"


def plain_name(name: str, labels: Collection[str]) -> tuple[str, str | None]:
    """Return a name of the table as its home knows it, and that home's label; None where it could be any."""
    plain, _, label = name.rpartition(" @")
    return (plain, label) if plain and label in labels else (name, None)


def _beside(text: str, prefix: str, argument: str) -> Beside:
    label, equals, place = text.partition("=")
    if not equals or "/" in label or not place:
        label, place = "", text
    url = archive_url(place)
    path = Path(place).expanduser().absolute() if "://" not in place else None
    if path is not None and not path.exists():
        raise InputError(f"{prefix}{place}: no such folder or file", argument)
    if path is not None and path.is_file():
        path = path.parent
    elif path is not None and not (path / "archive.sqlite").exists():
        raise InputError(f"{prefix}{place}: is no home: it holds {_instead(path)}", argument)
    label = label or re.sub(r"[^A-Za-z0-9._-]+", "-", path.name if path else _database(url)).strip("-.")
    if not _LABEL.fullmatch(label):
        from slamhive.archive.connection import shown  # noqa: PLC0415 - as below

        what = place if path is not None else shown(url)
        raise InputError(
            f"{prefix}{what}: call it by LABEL=PATH; a label has letters, digits, - . and _", argument
        )
    return Beside(label, url, path)


def _instead(folder: Path) -> str:
    """Return the end of a sentence on a folder that is no home: a few names of its files."""
    try:
        names = sorted(path.name for path in folder.iterdir())
    except OSError:
        names = []
    more = ", …" if len(names) > _SHOWN else ""
    return "no archive.sqlite" + (f", but {', '.join(names[:_SHOWN])}{more}" if names else "")


def _database(url: str) -> str:
    from slamhive.archive.connection import parse  # noqa: PLC0415 - a home of one's own needs no SQLAlchemy

    return str(parse(url).database)


def _without(frame: Frame, seen: set[tuple[Any, ...]]) -> Frame:
    """Return the rows that no earlier home has."""
    rows = list(zip(*(frame.column(name).tolist() for name in _SAME), strict=True))
    kept = np.array([row not in seen for row in rows], dtype=bool)
    seen.update(rows)
    return frame if kept.all() else frame.select(kept)


def _told_apart(frame: Frame, name: str, version: str, label: str, known: dict[str, set[str]]) -> Column:
    """Return the names of a column, with the home's label where a name means something else already.

    Args:
        frame: the rows of a home.
        name: the column of names.
        version: the column that says what each of them is.
        label: of the home.
        known: the current versions of each name in the homes before; this one's are added.
    """
    names, versions = frame.column(name).tolist(), frame.column(version).tolist()
    current = ~frame.column("superseded").present
    here: dict[str, set[str]] = {}
    for one, what, counts in zip(names, versions, current.tolist(), strict=True):
        if one is not None and what is not None and counts:
            here.setdefault(one, set()).add(what)

    def means_the_same(one: str, what: str | None) -> bool:
        if one not in known:
            return True
        return what in known[one] if what is not None else here.get(one, set()) <= known[one]

    found = [
        one if one is None or means_the_same(one, what) else told_name(one, label)
        for one, what in zip(names, versions, strict=True)
    ]
    for one, what in here.items():
        known.setdefault(one, what)
    return Column.of(found)


def _own_uids(frame: Frame, label: str, uids: dict[str, str | None]) -> Column:
    """Return the UIDs, with the home's label where another run has one already."""
    contents = frame.column("provenance.contentHash").tolist()
    given = frame.column("uid").tolist()
    found = [
        uid if uids.get(uid, content) == content else f"{uid}~{label}"
        for uid, content in zip(given, contents, strict=True)
    ]
    uids.update((uid, content) for uid, content in zip(found, contents, strict=True) if uid not in uids)
    return Column.of(found)
