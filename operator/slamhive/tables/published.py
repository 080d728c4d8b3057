# SPDX-License-Identifier: Apache-2.0
"""Published numbers beside own results: which there are, which belong to a dataset, why own ones may differ.

They never become rows of the table of runs, so no average, rank, count or test can take them in. Commands and
the dashboard ask here.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import ValidationError

import slamhive
from slamhive.analysis.measures import figures, is_error, is_listed
from slamhive.analysis.metrics import Metric
from slamhive.model.base import explain
from slamhive.model.catalogue import load_catalogue, sequence_attributes
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.model.published import PublishedNumbers, PublishedStatistic
from slamhive.tables.verdicts import SAME_LENGTH, Agreement, Assessment, OwnRuns, alignment_words, plain_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.analysis.frame import Frame
    from slamhive.model.catalogue import Family
    from slamhive.model.published import PublishedRow, PublishedSource, PublishedTable

FOLDER = "published"
BUNDLED = Path(slamhive.__file__).parent / FOLDER
_MOST_BYTES = 2**22
_MOST_PLACES = 3
_CLOSE = 0.75
"""Likeness from which on a name is a misspelt other one."""
_CLOSEST = 0.85
"""Likewise of columns, which are longer."""
_RPES = 10
"""RPEs whose columns are proposed."""
_NEVER_SMALLER = {"min": ("median", "mean", "rmse", "max"), "median": ("max",)} | {
    "mean": ("rmse", "max"),
    "rmse": ("max",),
}
"""Statistics of one error by those that are never larger."""
_ROUNDED = 1e-9


@dataclass(frozen=True)
class Published:
    """A published row, on a dataset that is known here.

    Attributes:
        dataset: the dataset's name here.
        row, table, source: what was published.
        values: numbers in stored units, by column.
        differences: why own numbers may differ, a sentence each.
        verdicts: on own runs beside these numbers, by column; of errors alone.
        other: why the recording here is another one than the sequence; empty where it isn't known to be.
        along: whether it comes with slamhive.
    """

    dataset: str
    row: PublishedRow
    table: PublishedTable
    source: PublishedSource
    values: dict[str, float]
    differences: tuple[str, ...] = ()
    verdicts: dict[str, Assessment] = field(default_factory=dict)
    other: str = ""
    along: bool = False

    @property
    def is_unrun(self) -> bool:
        """Tell whether no own run is of this system."""
        return {Agreement.NOT_RUN} == {one.verdict for one in self.verdicts.values()}

    @property
    def is_drawn(self) -> bool:
        """Tell whether charts show it: on this recording, and of a system that was run or that was added.

        All that come with slamhive would hide own runs.
        """
        return not self.other and not (self.along and self.is_unrun)

    @property
    def system(self) -> str:
        """Return the system with its sensors and parameters, as people write it."""
        parameters = ", ".join(f"{name} {value}" for name, value in self.row.parameters.items())
        parts = [self.row.system, str(self.row.sensors) if self.row.sensors else "", parameters]
        return " ".join(part for part in parts if part)

    @property
    def where(self) -> str:
        """Return the place of publication: venue, year and place."""
        source = self.source
        name = f"{source.venue} {source.year}" if source.venue and source.year else source.title
        return f"{name}, {self.table.place}"

    def flat(self) -> dict[str, Any]:
        """Return it as a flat record; no column is one that own results have."""
        table, row = self.table, self.row
        return {
            "published": self.where,
            "published.system": row.system,
            "published.sensors": str(row.sensors) if row.sensors else None,
            "published.dataset": row.dataset,
            "published.alignment": str(table.alignment) if table.alignment else None,
            "published.statistic": str(table.statistic) if table.statistic else None,
            "published.runs": table.runs,
            "published.notes": row.notes,
            "published.url": self.source.url or self.source.doi,
            "dataset": self.dataset,
            **{f"published.parameters.{name}": value for name, value in row.parameters.items()},
            **{f"published.{name}": value for name, value in self.values.items()},
            **{f"published.{name}.own": judged.own for name, judged in self.verdicts.items()},
            **{f"published.{name}.verdict": judged.sentence for name, judged in self.verdicts.items()},
        }


def read_published(path: Path) -> PublishedNumbers:
    """Read a file of published numbers.

    Raises:
        InputError: it can't be read, or isn't one; names the field.
    """
    try:
        return _read(path, path.stat().st_mtime_ns)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None


@lru_cache(maxsize=64)
def _read(path: Path, _changed: int) -> PublishedNumbers:
    """Read a file; one that hasn't changed is read once."""
    try:
        with path.open("rb") as file:
            text = file.read(_MOST_BYTES + 1)
        if len(text) > _MOST_BYTES:
            raise InputError(f"{path}: more than {_MOST_BYTES >> 20} MiB")
        content = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # noqa: S506 - a safe loader
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: no YAML: {' '.join(str(error).split())[:300]}") from None
    try:
        numbers = PublishedNumbers.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the file"
        raise InputError(f"{path}: {place}: {explain(first)}") from None
    for table in numbers.tables:
        for name in {name for row in table.rows for name in row.values}:
            _metric(table, name, f"{path}: {table.place}")
            _require_known(name, f"{path}: {table.place}")
        for row in table.rows:
            for name, value in (*row.values.items(), *row.spreads.items()):
                if value < 0 and is_error(name):
                    where = f"{path}: {table.place}: {row.system} on {row.dataset}"
                    raise InputError(f"{where}: {name}: expected a number from 0 on, found {value:g}")
            _require_order(table, row, f"{path}: {table.place}: {row.system} on {row.dataset}")
    return numbers


def _require_order(table: PublishedTable, row: PublishedRow, where: str) -> None:
    """Refuse statistics of one error that can't be of one trajectory, as in columns that were swapped.

    Raises:
        InputError: one is larger than another that is never smaller.
    """
    for name, value in row.values.items():
        kind, _, statistic = name.rpartition(".")
        for larger in _NEVER_SMALLER.get(statistic, ()):
            other = row.values.get(f"{kind}.{larger}")
            if other is None or not is_error(name):
                continue
            # Numbers as printed: rounding keeps their order, units may not.
            smaller = value / _metric(table, name).factor
            if smaller > other / _metric(table, f"{kind}.{larger}").factor * (1 + _ROUNDED):
                raise InputError(
                    f"{where}: {name} {value:g} is larger than {kind}.{larger} {other:g}, which is never "
                    "smaller; were columns or units swapped?"
                )


def _require_known(column: str, where: str) -> None:
    """Refuse the name of a column that is a misspelt other one; others may be of somebody's own.

    Raises:
        InputError: it seems to be.
    """
    close = [] if is_listed(column) else get_close_matches(column, figures(_RPES), 1, _CLOSEST)
    if close:
        raise InputError(f"{where}: unknown column {column!r}; did you mean {close[0]!r}?")


def check_names(numbers: PublishedNumbers, path: Path) -> list[str]:
    """Check the names of sequences against the catalogue; return remarks on those that nobody knows.

    Raises:
        InputError: a sequence of a family isn't one of it, or a row's dataset is a misspelt one.
    """
    catalogue = load_catalogue()
    known = _checked_families(numbers, catalogue, path)
    remarks = [
        f"{path.name}: family {family!r} is none of the catalogue; did you mean {close[0]!r}?"
        for family in numbers.families
        if family not in catalogue and (close := get_close_matches(family, catalogue, 1, _CLOSE))
    ]
    given = {name for members in numbers.families.values() for name in members}
    for name, metres in numbers.lengths.items():
        holders = [family for family, one in catalogue.items() if name in one.rows]
        if name not in given and len(holders) == 1 and (wrong := _wrong_length(metres, holders, name)):
            remarks.append(f"{path.name}: lengths: {wrong}; is another sequence meant?")
    every = known or {name for family in catalogue.values() for name in family.rows}
    for place, table in enumerate(numbers.tables):
        for name in dict.fromkeys(row.dataset for row in table.rows):
            close = [] if name in every else get_close_matches(name, sorted(every), 1, _CLOSE)
            if close and known:
                where = f"{path}: tables.{place} ({table.place})"
                raise InputError(
                    f"{where}: dataset {name!r} is in none of the families; did you mean {close[0]!r}?"
                )
            if close:
                remarks.append(f"{path.name}: no sequence {name!r} is known; did you mean {close[0]!r}?")
    return remarks


def _checked_families(numbers: PublishedNumbers, catalogue: Mapping[str, Family], path: Path) -> set[str]:
    """Return the sequences of a file's families, and all others of those that the catalogue has."""
    known = {name for own in numbers.families.values() for name in own}
    for family, members in numbers.families.items():
        if family not in catalogue:
            continue
        for name in members:
            if name not in catalogue[family].rows:
                raise UnknownNameError("sequence", name, catalogue[family].rows, f"{path}: families.{family}")
        known |= set(catalogue[family].rows)
    for name, metres in numbers.lengths.items():
        if known and name not in known:
            raise UnknownNameError("sequence", name, known, f"{path}: lengths")
        of = [family for family, members in numbers.families.items() if name in members]
        if of and (wrong := _wrong_length(metres, of, name)):
            raise InputError(f"{path}: lengths: {wrong}")
    return known


def _wrong_length(metres: float, families: Sequence[str], sequence: str) -> str:
    """Say what is wrong with the length of a sequence, as the catalogue knows it; empty where nothing is."""
    for family in families:
        right = sequence_attributes(family, sequence).get("lengthMetres")
        if right is not None and abs(metres - float(right)) > SAME_LENGTH * float(right):
            return f"{sequence} of {family} is {right} m long, not {metres:g}"
    return ""


def published_files(home: Path | None) -> list[Path]:
    """Return the files of published numbers: those that come with slamhive, then a home's."""
    folders = [BUNDLED, *([home / FOLDER] if home is not None else [])]
    return [path for folder in folders for path in sorted(folder.glob("*.y*ml"))]


def load_published(home: Path | None) -> list[PublishedNumbers]:
    """Return all published numbers that are known.

    Raises:
        InputError: a file of the home is none.
    """
    return [read_published(path) for path in published_files(home)]


def published_on(frame: Frame, known: Iterable[PublishedNumbers]) -> list[Published]:
    """Return the published rows on the datasets of some runs, those of systems that weren't run last.

    A sequence is a dataset of the runs if their names are equal but for case and punctuation, if the dataset
    is called FAMILY-SEQUENCE by a family of the file, or if its attribute ``sequence`` is the sequence.

    Args:
        frame: the runs, one row a run and evaluation.
        known: all published numbers.
    """
    names = _identities(frame)
    along = load_published(None)
    own: dict[tuple[str, str, float | None, float | None], tuple[_Own, OwnRuns]] = {}
    found = []
    for numbers in known:
        comes_along = numbers in along
        families: dict[str, list[str]] = {}
        lengths: dict[str, tuple[float | None, float | None]] = {}
        for family, members in numbers.families.items():
            for name in members:
                families.setdefault(name, []).append(family)
        for table in numbers.tables:
            for row in table.rows:
                of = families.get(row.dataset, [])
                meant = [plain_name(row.dataset), *(plain_name(f"{one}-{row.dataset}") for one in of)]
                for dataset in dict.fromkeys(names[name] for name in meant if name in names):
                    if row.dataset not in lengths:
                        lengths[row.dataset] = _lengths(numbers, of, row.dataset)
                    metres, seconds = lengths[row.dataset]
                    key = (dataset, row.dataset, metres, seconds)
                    if key not in own:
                        chosen = _of_dataset(frame, dataset)
                        own[key] = (_Own.of(chosen), OwnRuns(chosen, row.dataset, metres, seconds))
                    item = _published(dataset, row, table, numbers.source, own[key])
                    found.append(replace(item, along=comes_along))
    return sorted(found, key=lambda item: item.is_unrun)


def _published(
    dataset: str, row: PublishedRow, table: PublishedTable, source: PublishedSource, own: tuple[_Own, OwnRuns]
) -> Published:
    alignments, runs = own
    factors = {name: _metric(table, name).factor for name in row.values}
    values = {name: value / factors[name] for name, value in row.values.items()}
    spreads = {name: value / factors[name] for name, value in row.spreads.items() if name in factors}
    verdicts = {
        name: runs.judge(table, row, name, value, spreads.get(name))
        for name, value in values.items()
        if is_error(name)  # load is that of another machine
    }
    why = tuple(_differences(table, row, alignments))
    other = runs.why if runs.is_other else ""
    return Published(dataset, row, table, source, values, why, verdicts, other)


def _of_dataset(frame: Frame, dataset: str) -> Frame:
    codes, values = frame.column("dataset").factorized()
    return frame.select(codes == values.index(dataset))


def _lengths(
    numbers: PublishedNumbers, families: Sequence[str], sequence: str
) -> tuple[float | None, float | None]:
    """Return a sequence's length in m and in s: as the catalogue has it, else the file."""
    said = next((one for family in families if (one := sequence_attributes(family, sequence))), {})
    metres, seconds = said.get("lengthMetres"), said.get("durationSeconds")
    return (
        float(metres) if metres is not None else numbers.lengths.get(sequence),
        float(seconds) if seconds is not None else None,
    )


def table_of(found: Sequence[Published], metrics: Sequence[Metric]) -> tuple[list[str], list[list[str]]]:
    """Return headings and lines of a table of published rows that have one of the metrics."""
    headings = ["published", "system", "sensors", "settings", "dataset", *(one.title for one in metrics)]
    errors = [metric for metric in metrics if is_error(metric.column)]
    lines = []
    for item in found:
        if not any(metric.column in item.values for metric in metrics):
            continue
        told = {one.title: item.verdicts[one.column] for one in errors if one.column in item.verdicts}
        said = list(dict.fromkeys(judged.sentence for judged in told.values()))
        verdict = said[0] if len(said) == 1 else "; ".join(f"{one}: {told[one].sentence}" for one in told)
        table, row = item.table, item.row
        parameters = ", ".join(f"{name} {value}" for name, value in row.parameters.items())
        numbers = [metric.show(item.values.get(metric.column)) for metric in metrics]
        lines.append(
            [
                item.where,
                row.system,
                str(row.sensors or "–"),
                parameters or "–",
                item.dataset,
                *numbers,
                verdict or "–",
                _statistic(table),
                str(table.alignment or "not said"),
                row.notes or "",
            ]
        )
    return [*headings, "own runs", "of", "alignment", "notes"], lines


def differences_of(found: Sequence[Published]) -> list[str]:
    """Return the reasons that own numbers may differ from published ones, each once, with where it holds.

    Systems that were run here are meant, where there are any.
    """
    places: dict[str, dict[str, None]] = {}
    for item in [one for one in found if not one.is_unrun] or found:
        for sentence in item.differences:
            places.setdefault(sentence, {})[item.where] = None
    return [f"{_some([*where])}: {sentence}" for sentence, where in places.items()]


def _some(places: Sequence[str]) -> str:
    more = len(places) - _MOST_PLACES
    return "; ".join([*places[:_MOST_PLACES], *([f"{more} more"] if more > 0 else [])])


@dataclass(frozen=True)
class _Own:
    """Alignments of own results on a dataset, compared with those of published ones."""

    alignments: frozenset[str]

    @classmethod
    def of(cls, frame: Frame) -> _Own:
        return cls(frozenset(alignment_words(frame)))


def _differences(table: PublishedTable, row: PublishedRow, own: _Own) -> Iterable[str]:
    """Say what may make own numbers differ; what is known of both is compared."""
    if table.alignment is None:
        yield "the alignment isn't said; SE(3) keeps errors of scale, Sim(3) takes them out"
    elif own.alignments and str(table.alignment).lower() not in {one.lower() for one in own.alignments}:
        yield (
            f"aligned by {table.alignment}, own runs by {', '.join(sorted(own.alignments))}; "
            "measure them alike by an Evaluation"
        )
    yield (
        f"measured are {table.poses}; own runs are measured at every pose that they wrote"
        if table.poses
        else "whether keyframes or all poses are measured isn't said, nor whether they are causal "
        "or final ones"
    )
    if table.statistic is PublishedStatistic.BEST:
        yield f"the best of {table.runs or 'several'} runs; own tables have means and medians"
    elif table.runs == 1:
        yield "a single run; its spread isn't known"
    if table.frame is not None:
        yield f"poses of the {table.frame}; own runs are measured in the frame that they wrote"
    yield (
        f"against {table.truth}"
        if table.truth
        else "against the publishers' ground truth of that time; was it corrected since?"
    )
    if row.notes:
        yield f"{row.system} on {row.dataset}: {row.notes}"


def _statistic(table: PublishedTable) -> str:
    count = f"{table.runs} run{'s' if table.runs != 1 else ''}" if table.runs else "runs not said"
    if table.statistic is None or table.statistic is PublishedStatistic.SINGLE:
        return count
    return f"{str(table.statistic).lower()} of {count}"


def _metric(table: PublishedTable, name: str, where: str = "") -> Metric:
    """Return a column with the unit in which a table has it.

    Raises:
        InputError: the unit doesn't fit.
    """
    unit = table.units.get(name)
    try:
        # What isn't said is as stored, not as it is shown by default.
        return Metric.parse(f"{name}:{unit}") if unit else Metric(name, "", 1.0)
    except InputError as error:
        raise InputError(f"{where}: units: {error}") from None


def _identities(frame: Frame) -> dict[str, str]:
    """Return the names of datasets here by all that a sequence may be called."""
    datasets = frame.column("dataset").tolist()
    found: dict[str, str] = {}
    if frame.has("dataset.attributes.sequence"):
        said = frame.column("dataset.attributes.sequence").tolist()
        found = {
            plain_name(str(sequence)): name
            for name, sequence in zip(datasets, said, strict=True)
            if sequence is not None and name is not None
        }
    return found | {plain_name(name): name for name in dict.fromkeys(datasets) if name is not None}
