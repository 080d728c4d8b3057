# SPDX-License-Identifier: Apache-2.0
"""Runs as other programs keep them: settings, figures, series over time, files and tags."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any

from slamhive.analysis.columns import ColumnKind
from slamhive.model.canonical import digest
from slamhive.runfiles.errors import FileMissingError, FileTooLargeError
from slamhive.runfiles.trajectories import usage_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from slamhive.analysis.frame import Frame
    from slamhive.bridges.places import Here

MOST_SAMPLES = 1000
"""Samples of a run's usage that are handed on; of each stretch the mean load and the largest memory."""

_SETTINGS = ("algorithm", "sensors", "dataset", "seed", "parameters.", "input.", "resources.")
_TAGS = (
    *("sweep", "dataset", "algorithm", "repetition", "name", "run", "uid", "namespace", "cluster"),
    *(
        "note",
        "tags",
        "phase",
        "status",
        "reason",
        "algorithm.version",
        "dataset.version",
        "provenance.contentHash",
    ),
    *("provenance.cpuModel", "provenance.machine.governor"),
    *("provenance.slamhiveVersion", "provenance.reusedFrom", "usage.memory.kind"),
)
_OF_EVALUATION = ("evaluation", "alignment", "outcome")
_NO_FIGURES = (
    *("id", "index", "repetition", "seed", "attempts", "disturbed", "superseded", "sweep.uid"),
    *("parameters.", "input.", "resources.", "provenance.", "labels.", "attributes.", "transform"),
    *("created", "started", "finished"),
)
_FIGURES_OF_RUN = ("usage.", "frames.", "metrics.", "trajectory.")
_LONGEST_FITTED = 200
_INDEX = re.compile(r"\[(\d+)\]")


@dataclass
class Handed:
    """A run to be handed on.

    Attributes:
        uid: what it is known by, for good.
        name: for people.
        sweep: its sweep; ``runs`` for a run of none.
        settings: parameters and options.
        figures: numbers by column; where runs have several evaluations, after the evaluation's name and a /.
        tags: texts by name.
        started, finished: times, s since 1970; None where they aren't known.
        series: usage over time: ``t`` (s since the start), ``cpu`` (cores), ``memory`` (bytes).
        files: paths of its files.
        failed: whether it failed.
        evaluations: those that its figures are of.
    """

    uid: str
    name: str
    sweep: str
    settings: dict[str, Any] = field(default_factory=dict)
    figures: dict[str, float] = field(default_factory=dict)
    tags: dict[str, str] = field(default_factory=dict)
    started: float | None = None
    finished: float | None = None
    series: Mapping[str, Sequence[float]] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    failed: bool = False
    evaluations: list[str] = field(default_factory=list)

    @property
    def short(self) -> str:
        """Return a name for files and folders: the run's, told apart by its UID."""
        return f"{plain(self.name)}-{digest(self.uid)[:8]}"

    @property
    def began(self) -> float:
        """Return the time of its start, s since the epoch, or 0 where nothing is known."""
        return self.started or self.finished or 0.0

    def digest(self) -> str:
        """Return a hash of all that is handed on, by which it is known whether anything is new."""
        series = {name: list(map(float, values)) for name, values in self.series.items()}
        return digest(
            [self.name, self.sweep, self.settings, self.figures, self.tags, self.began, series, self.files]
        )


class FittedNames:
    """Names as a program takes them: one that it would refuse is replaced, and kept in a tag.

    Args:
        fit: returns a name as the program takes it.
        settings: whether it refuses names of settings too, and not of figures alone.

    Attributes:
        changed: names that were replaced, by what is in their place.
    """

    def __init__(self, fit: Callable[[str], str], *, settings: bool = True) -> None:
        self._fit = fit
        self._settings = settings
        self.changed: dict[str, str] = {}

    def fitted(self, run: Handed) -> Handed:
        """Return a run with names that the program takes."""
        names = {name: self._one(name) for name in (*(run.settings if self._settings else ()), *run.figures)}
        return replace(
            run,
            settings={names.get(name, name): value for name, value in run.settings.items()},
            figures={names[name]: value for name, value in run.figures.items()},
            tags={self._one(name): value for name, value in run.tags.items()}
            | {f"renamed.{new}": name for name, new in names.items() if new != name},
        )

    def _one(self, name: str) -> str:
        found = self._fit(name)
        if found == name:
            return name
        # Its digest keeps two apart that would be one, in later exports into the same folder too.
        new = f"{found[:_LONGEST_FITTED]}-{digest(name)[:6]}"
        self.changed[name] = new
        return new


def plain(name: str) -> str:
    """Return a name as a part of a path."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip(".-")[:80] or "run"


def handed(frame: Frame, source: Here) -> Iterator[Handed]:
    """Yield the runs of a table, each once, in its order.

    Args:
        frame: rows, one a run and evaluation.
        source: where their files are.
    """
    names = [name for name in frame.names if not frame.column(name).is_empty]
    kinds = {name: frame.column(name).kind for name in names}
    evaluations = {name for name in frame.column("evaluation").tolist() if name is not None}
    rows: dict[str, list[int]] = {}
    for number, uid in enumerate(frame.column("uid").tolist()):
        rows.setdefault(str(uid), []).append(number)
    for uid, places in rows.items():
        first = frame.row(places[0], names)
        one = Handed(uid, str(first.get("name") or uid), str(first.get("sweep") or "runs"))
        one.settings = {name: value for name, value in first.items() if _is_of(name, _SETTINGS)}
        one.settings = {name: _scalar(value) for name, value in one.settings.items() if value is not None}
        one.tags = {name: str(first[name]) for name in _TAGS if first.get(name) is not None}
        one.started, one.finished = _time(first.get("started")), _time(first.get("finished"))
        one.failed = first.get("phase") != "Succeeded"
        for place in places:
            _take(one, frame.row(place, names), kinds, several=len(evaluations) > 1)
        _files(one, source)
        yield one


def _take(one: Handed, row: Mapping[str, Any], kinds: Mapping[str, ColumnKind], *, several: bool) -> None:
    """Take in the figures of one evaluation."""
    evaluation = row.get("evaluation")
    prefix = f"{evaluation}/" if several and evaluation else ""
    one.evaluations += [str(evaluation)] if evaluation else []
    for name, value in row.items():
        if kinds[name] not in {ColumnKind.NUMBER, ColumnKind.INTEGER} or _is_of(name, _NO_FIGURES):
            continue
        if value is not None and math.isfinite(value):
            begin = "" if _is_of(name, _FIGURES_OF_RUN) else prefix
            one.figures[begin + _INDEX.sub(r".\1", name)] = float(value)
    one.tags |= {prefix + name: str(row[name]) for name in _OF_EVALUATION if row.get(name) is not None}


def _files(one: Handed, source: Here) -> None:
    """Take in a run's files and its usage over time, where they are here."""
    record = source.record(one.uid)
    place = source.place(record) if record is not None else None
    if place is None:
        return
    folder = place.root.joinpath(*place.parts)
    one.files = [str(folder / str(item["path"])) for item in place.files()]
    one.tags["folder"] = str(folder)
    try:
        found = usage_columns(place, MOST_SAMPLES)
    except (FileMissingError, FileTooLargeError):
        return
    one.series = {name: found[name].tolist() for name in ("t", "cpu", "memory")}


def _is_of(name: str, group: Sequence[str]) -> bool:
    """Tell whether a column is one of some; those that end with a dot stand for all below."""
    return any(name.startswith(one) if one.endswith(".") else name == one for one in group)


def _scalar(value: Any) -> Any:
    return value if isinstance(value, bool | int | float | str) else json.dumps(value)


def _time(value: Any) -> float | None:
    if isinstance(value, int | float):
        return float(value)
    if isinstance(value, datetime):
        return value.timestamp()
    if isinstance(value, str):
        return datetime.fromisoformat(value).timestamp()
    return None
