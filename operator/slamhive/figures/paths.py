# SPDX-License-Identifier: Apache-2.0
"""Figures of files that runs left: where they went, how far off they were, what they cost over time."""

from __future__ import annotations

from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import sort_key
from slamhive.analysis.grouping import Groups, counting
from slamhive.bridges.places import Here
from slamhive.figures.asking import MOST_SERIES, FigureKind, check_panels, error_of, nothing, parted
from slamhive.figures.groups import Series
from slamhive.figures.pictures import Line, Panel, Picture, PictureAxis
from slamhive.model.base import plural
from slamhive.model.errors import InputError
from slamhive.model.results import MemoryKind
from slamhive.reporting.questions import is_setting, varied
from slamhive.reporting.titles import keys_text
from slamhive.runfiles.clocks import clock_of, configuration_of
from slamhive.runfiles.errors import RunFileError
from slamhive.runfiles.trajectories import drawn, extrinsic_of, read_poses, usage_columns
from slamhive.tables.homes import COLUMN, OWN, uid_in

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from slamhive.analysis.columns import Floats, Indices
    from slamhive.analysis.frame import Frame
    from slamhive.archive.records import CatalogEntry
    from slamhive.figures.asking import Wish
    from slamhive.local.home.folder import Home
    from slamhive.model.results import Result, RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder
    from slamhive.tables.homes import Beside

    Rows = dict[str, Floats]
    _Group = tuple[int, int, dict[str, Any], Frame, Indices]

MOST_RUNS = 100
"""Runs whose files are read for a figure."""

MOST_POSES = 1000
_LONG_SECONDS = 1.0
_LONG_STEPS = 5.0
"""A gap that no line crosses is longer than this, and than so many usual steps."""

_SIDES = ("x", "y", "z")
_MEMORY = {
    MemoryKind.RESIDENT: "what all processes had resident",
    MemoryKind.WORKING_SET: "the working set",
    MemoryKind.CONTAINER: "all of the container's, with files that were read",
}
_MIB = 2.0**-20


@dataclass(frozen=True)
class Found:
    """A run, and where its files are.

    Attributes:
        record: the run.
        place: its folder.
        evaluation: what it was measured by.
        algorithms: versions of the Algorithms in the archive.
        here: its home, which knows the ground truth.
    """

    record: RunRecord
    place: ArtifactFolder
    evaluation: str | None
    algorithms: list[CatalogEntry]
    here: Here

    def path(self) -> tuple[dict[str, Any], float]:
        """Return the aligned path over its ground truth, and the zero of its dataset's clock."""
        record = self.record
        truth = self.here.truth(record)
        poses = read_poses(self.place)
        configuration = configuration_of(self.place)
        extrinsic = extrinsic_of(record, configuration, self.algorithms, truth)
        cut = record.spec.get("input") or {}
        whole = not cut.get("start") and cut.get("duration") is None
        path = drawn(poses, self._result(), truth, extrinsic, MOST_POSES, whole=whole)
        clock = clock_of(configuration, truth, poses.poses)
        return path, clock.start if clock is not None else 0.0

    def _result(self) -> Result | None:
        return next((one for one in self.record.results if one.evaluation == self.evaluation), None)


@dataclass(frozen=True)
class Reader:
    """Reads one run's file for a figure.

    Attributes:
        read: returns columns of numbers with a line's x and y first, and notes.
        x, y: the names of those columns.
        labels: of the axes.
    """

    read: Callable[[Found], tuple[Rows, Rows | None, list[str]]]
    x: str
    y: str
    labels: tuple[str, str]


class _Lines:
    """Lines of the runs that were chosen, by panel, with what is said of them."""

    def __init__(self) -> None:
        self.drawn: dict[int, list[Line]] = {}
        self.truths: dict[int, Line] = {}
        self.columns: dict[str, list[Any]] = {}
        self.notes: list[str] = []
        self.missing: list[str] = []
        self.runs = 0

    def read(self, found: Found | str, choice: ChosenRun, reader: Reader, *, thin: bool) -> None:
        """Read a run's file; what can't be read is said."""
        if isinstance(found, str):
            self.missing.append(found)
            return
        try:
            table, truth, said = reader.read(found)
        except RunFileError as problem:
            self.missing.append(f"{found.record.name}: {problem}")
            return
        self.runs += 1
        self.notes += said
        self.drawn.setdefault(choice.panel, []).append(_line(choice.series, table, reader, thin=thin))
        known = self.truths.get(choice.panel)
        if truth is not None and (known is None or len(truth[reader.x]) > len(known.x)):
            self.truths[choice.panel] = _line(-1, truth, reader)
        length = len(table[reader.x])
        keys = choice.keys | {"run": choice.frame.row(choice.row, ("run",))["run"]}
        for name in (*keys, *table):
            values = [keys[name]] * length if name in keys else table[name].tolist()
            self.columns.setdefault(name, []).extend(values)


@dataclass(frozen=True, eq=False)
class ChosenRun:
    """A run that is drawn.

    Attributes:
        panel, series: where, and as what.
        keys: what panel and series are, and its settings.
        frame, row: the run.
    """

    panel: int
    series: int
    keys: dict[str, Any]
    frame: Frame
    row: int


def paths(frame: Frame, wish: Wish, home: Home, also: Sequence[Beside] = ()) -> Picture:
    """Return lines of runs' files: of each series the run of median error, or every run."""
    reader = _READERS[wish.kind](wish)
    facet = wish.columns("facet", (), frame)
    by = _told(frame, wish, facet)
    facet = tuple(dict.fromkeys([*facet, *(("dataset",) if "dataset" not in by else ())]))
    parts = parted(frame, facet, by, ("usage.",) if wish.kind is FigureKind.USAGE else ())
    varying = [name for name in parts.names if len({repr(keys[name]) for keys, _ in parts.panels}) > 1]
    check_panels(len(parts.panels), varying, parts.frame, wish.facet)
    series = Series(by, parts.frame)
    groups = [
        (panel, series.of(values), keys | values, part, rows[counting(part, wish.outcomes)[rows]])
        for panel, (keys, part) in enumerate(parts.panels)
        for rows, values in _groups(part, by)
    ]
    settings = _SettingsTried(parts.frame, [*parts.names, *by], groups)
    chosen = [
        ChosenRun(panel, number, keys | settings.of(part, row), part, row)
        for panel, number, keys, part, rows in groups
        for row in (rows.tolist() if wish.each else _median(part, rows, settings))
    ]
    copies: list[ChosenRun] = []
    if wish.each and wish.kind is not FigureKind.USAGE:
        chosen, copies = _without_copies(chosen)
    if not chosen:
        raise nothing("a path" if wish.kind is not FigureKind.USAGE else "usage")
    if len(chosen) > MOST_RUNS:
        raise InputError(
            f"{len(chosen):,} runs would be drawn, and the files of at most {MOST_RUNS} are read for a "
            "figure: choose some by --where"
        )
    lines = _Lines()
    for choice, found in zip(chosen, _located(chosen, home, also), strict=True):
        lines.read(found, choice, reader, thin=len(chosen) > MOST_SERIES)
    if not lines.runs:
        raise InputError(f"no run has files here to draw: {lines.missing[0]}")
    panels = []
    for number, (keys, _) in enumerate(parts.panels):
        if number in lines.drawn:
            truth = (lines.truths[number],) if number in lines.truths else ()
            title = parts.title({name: keys[name] for name in varying})
            panels.append(Panel(title, (*truth, *lines.drawn[number])))
    lost = [f"{len(lines.missing)} of them not drawn: {lines.missing[0]}"] if lines.missing else []
    told = {} if wish.each else settings.told(chosen)
    count = sum(len(rows) for *_, rows in groups)
    stated = _each(chosen, copies, settings) if wish.each else _stated(count, chosen, settings)
    datasets = {repr(choice.keys.get("dataset")) for choice in chosen}
    is_path = wish.kind is FigureKind.TRAJECTORIES
    return Picture(
        x=PictureAxis(reader.labels[0], bool(wish.log.of("x")), robust=False),
        y=PictureAxis(
            reader.labels[1],
            bool(wish.log.of("y")),
            robust=wish.robust and wish.kind is FigureKind.ERROR_OVER_TIME,
        ),
        panels=tuple(panels),
        series=tuple(
            ", ".join(filter(None, [label, told.get(number, "")]))
            for number, label in enumerate(series.labels)
        ),
        notes=(*stated, *lost, *dict.fromkeys(lines.notes)),
        columns=lines.columns,
        runs=lines.runs,
        equal=is_path,
        apart=is_path and len(datasets) > 1,
        truth=bool(lines.truths),
        shared="" if wish.each else settings.shared(chosen),
    )


class _SettingsTried:
    """Settings that runs differ in beyond what tells series and panels apart.

    Args:
        frame: all runs.
        names: columns that tell series and panels apart.
        groups: panel, series, keys, frame and rows that count of each series of a panel.
    """

    def __init__(self, frame: Frame, names: Sequence[str], groups: Sequence[_Group]) -> None:
        self.names = [name for name in _settings(frame) if name not in names]
        order: dict[str, Any] = {}
        counts = []
        for *_, part, rows in groups:
            found = {row: self.text(part, row) for row in rows.tolist()}
            for row, text in found.items():
                order[text] = [sort_key(value) for value in self.of(part, row).values()]
            counts += [Counter(found.values())] if found else []
        common = set(counts[0]).intersection(*counts[1:]) if counts else set()
        # That which most runs have; of several the first.
        ranked = sorted(common, key=lambda text: (-sum(count[text] for count in counts), order[text]))
        self.common = ranked[0] if ranked else None
        self.several = len(set().union(*counts)) if counts else 0

    def of(self, part: Frame, row: int) -> dict[str, Any]:
        """Return the settings of a run."""
        return part.row(row, self.names) if self.names else {}

    def text(self, part: Frame, row: int) -> str:
        """Return the settings of a run in words, without those that its algorithm doesn't have."""
        return _words(self.of(part, row))

    def shared(self, chosen: Sequence[ChosenRun]) -> str:
        """Return the settings of all runs that are drawn where they are equal, and others were tried."""
        texts = {self.text(choice.frame, choice.row) for choice in chosen}
        return texts.pop() if len(texts) == 1 and self.several > 1 else ""

    def told(self, chosen: Sequence[ChosenRun]) -> dict[int, str]:
        """Return the settings of each series whose runs have the same in all panels, where series differ."""
        found: dict[int, set[str]] = {}
        for choice in chosen:
            found.setdefault(choice.series, set()).add(self.text(choice.frame, choice.row))
        if self.shared(chosen):
            return {}
        return {number: min(texts) for number, texts in found.items() if len(texts) == 1}


def _settings(frame: Frame) -> list[str]:
    """Return the settings that differ between runs of an algorithm, and what algorithms were fed unequally.

    Parameters that each algorithm has at one value say nothing that its name doesn't.
    """
    within = [name for name in varied(frame) if not name.startswith("dataset.")]
    fed = (name for name in frame.stored if name.startswith("input.") and is_setting(name))
    known = (name for name in fed if len(set(frame.column(name).unique()) - {None}) > 1)
    return list(dict.fromkeys([*within, *known]))


def _told(frame: Frame, wish: Wish, facet: Sequence[str]) -> tuple[str, ...]:
    """Return the columns that tell series apart: of every run also its settings, if they are not too many."""
    by = wish.series(frame, ("dataset",))
    if not wish.each or wish.by is not None:
        return by
    whole = (*by, *(name for name in _settings(frame) if name not in {*by, *facet}))
    return whole if len(Groups(frame, whole).keys) <= MOST_SERIES else by


def _groups(part: Frame, by: tuple[str, ...]) -> Iterator[tuple[Indices, dict[str, Any]]]:
    groups = Groups(part, by)
    return zip(groups.members(), groups.keys, strict=True)


def _median(part: Frame, rows: Indices, settings: _SettingsTried) -> list[int]:
    """Return the row of (lower) median error: of those with the settings that all series have, if any."""
    if settings.common is not None:
        rows = rows[[settings.text(part, row) == settings.common for row in rows.tolist()]]
    if len(rows) < 2:
        return [int(row) for row in rows]
    errors = part.column(error_of(part)).floats()[rows]
    order = np.argsort(errors, kind="stable")  # NaN last
    known = int((~np.isnan(errors)).sum()) or len(order)
    return [int(rows[order[(known - 1) // 2]])]


def _without_copies(chosen: Sequence[ChosenRun]) -> tuple[list[ChosenRun], list[ChosenRun]]:
    """Return the runs without those whose trajectory another of their panel has, and these."""
    seen: set[tuple[int, str]] = set()
    kept: list[ChosenRun] = []
    copies: list[ChosenRun] = []
    for choice in chosen:
        sha256 = choice.frame.row(choice.row, ("trajectory.sha256",))["trajectory.sha256"]
        known = sha256 is not None and (choice.panel, sha256) in seen
        (copies if known else kept).append(choice)
        seen.add((choice.panel, str(sha256)))
    return kept, copies


def _words(keys: Mapping[str, Any]) -> str:
    """Return keys in words, without those that an algorithm doesn't have."""
    return keys_text({name: value for name, value in keys.items() if value is not None})


def _each(chosen: Sequence[ChosenRun], copies: Sequence[ChosenRun], settings: _SettingsTried) -> list[str]:
    """Say which lines there are, and which are not told apart."""
    said = [f"each line is one of {plural(len(chosen), 'run')}"]
    if copies:
        said.append(f"{len(copies)} more have the same trajectory as one of them")
    looks = {(choice.panel, choice.series) for choice in chosen}
    lost = {_words(one.keys) for one in copies if (one.panel, one.series) not in looks}
    if lost:
        said.append(f"no line of its own, as it would be the same: {'; '.join(sorted(lost))}")
    if len({(one.panel, one.series, settings.text(one.frame, one.row)) for one in chosen}) > len(looks):
        said.append("runs of a series differ in settings: --by tells them apart")
    return said


def _stated(count: int, chosen: Sequence[ChosenRun], settings: _SettingsTried) -> list[str]:
    """Say which runs the lines are, of those that count."""
    if len(chosen) == count:
        return ["each line is one run, the only one of its series"]
    what = f"each line is one run: of {count} that count, the one of median error of each series and panel"
    if shared := settings.shared(chosen):
        which = f"one of {settings.several} settings that ran; --where chooses others, --each draws all"
        return [f"{what} with {shared}, {which}"]
    texts = {_words(choice.keys) for choice in chosen}
    named = [f"they are {'; '.join(sorted(texts))}"] if settings.several > 1 else []
    return [f"{what}; --each draws all", *named]


def _located(chosen: list[ChosenRun], home: Home, also: Sequence[Beside]) -> Iterator[Found | str]:
    """Go through the runs with their folders; a sentence for one that has none here."""
    places = {OWN: (home.archive_url, home.path), **{one.label: (one.url, one.path) for one in also}}
    homes: dict[str, tuple[Here, list[CatalogEntry]]] = {}
    with ExitStack() as stack:
        for choice in chosen:
            told = choice.frame.row(choice.row, ("uid", "evaluation", "name", COLUMN))
            label = str(told[COLUMN] or OWN)
            if label not in homes:
                url, path = places[label]
                opened = stack.enter_context(Here.open(url, path))
                homes[label] = opened, opened.algorithms()
            here, algorithms = homes[label]
            record = _computed(here, here.record(uid_in(str(told["uid"]), places)[0]))
            place = here.place(record) if record is not None else None
            if record is None or place is None:
                yield f"{told['name']}: its folder is not here"
            else:
                yield Found(record, place, told["evaluation"], algorithms, here)


def _computed(here: Here, record: RunRecord | None) -> RunRecord | None:
    """Return the run that has the files of one that took over its result."""
    if record is None or record.folder or not record.provenance.reused_from:
        return record
    return here.record(record.provenance.reused_from) or record


def _line(number: int, table: Rows, reader: Reader, *, thin: bool = False) -> Line:
    """Return a line, interrupted where there was nothing for long."""
    x, y = table[reader.x], table[reader.y]
    times = table.get("t")
    if times is not None and len(times) > 2:
        steps = np.diff(times)
        gaps = np.flatnonzero(steps > max(_LONG_SECONDS, _LONG_STEPS * float(np.median(steps)))) + 1
        x, y = np.insert(x, gaps, np.nan), np.insert(y, gaps, np.nan)
    return Line(number, x, y, thin=thin)


def _trajectories(wish: Wish) -> Reader:
    sides = []
    for field, default in (("x", "x"), ("y", "y")):
        side = getattr(wish, field) or default
        if side not in _SIDES:
            raise InputError(f"{side[:60]!r}: a path is drawn along x, y or z", field)
        sides.append(side)

    def read(found: Found) -> tuple[Rows, Rows | None, list[str]]:
        path, _ = found.path()
        reference = path["reference"]
        return path["estimate"], reference, path["notes"]

    return Reader(read, sides[0], sides[1], (f"{sides[0]} [m]", f"{sides[1]} [m]"))


def _errors(wish: Wish) -> Reader:
    wish.refuse(x="errors are drawn over time", y="errors are of positions, in metres")

    def read(found: Found) -> tuple[Rows, Rows | None, list[str]]:
        path, zero = found.path()
        estimate = path["estimate"]
        known = ~np.isnan(estimate["error"])
        table = {"t": estimate["t"][known] - zero, "error": estimate["error"][known]}
        return table, None, path["notes"]

    return Reader(read, "t", "error", ("time [s]", "position error [m]"))


def _usage(wish: Wish) -> Reader:
    wish.refuse(x="usage is drawn over time")
    names = {"cpu": "CPU load [cores]", "memory": "memory [MiB]"}
    what = wish.y or "cpu"
    if what not in names:
        raise InputError(f"{what[:60]!r}: usage over time is cpu or memory", "y")

    def read(found: Found) -> tuple[Rows, Rows | None, list[str]]:
        table = usage_columns(found.place, 400)
        kind = table["kind"]
        notes = [] if what == "cpu" or kind is None else [f"memory is {_MEMORY[kind]}"]
        return {"t": table["t"], "cpu": table["cpu"], "memory": table["memory"] * _MIB}, None, notes

    return Reader(read, "t", what, ("time since the start [s]", names[what]))


_READERS: dict[FigureKind, Callable[[Wish], Reader]] = {
    FigureKind.TRAJECTORIES: _trajectories,
    FigureKind.ERROR_OVER_TIME: _errors,
    FigureKind.USAGE: _usage,
}
