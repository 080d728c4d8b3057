# SPDX-License-Identifier: Apache-2.0
"""Published numbers beside own results: which there are, which belong to a dataset, why own ones may differ.

They never become rows of the table of runs, so no average, rank, count or test can take them in. Commands and
the dashboard ask here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import ValidationError

import slamhive
from slamhive.analysis.metrics import Metric
from slamhive.model.base import explain
from slamhive.model.errors import InputError
from slamhive.model.published import PublishedNumbers, PublishedStatistic

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.analysis.frame import Frame
    from slamhive.model.published import PublishedRow, PublishedSource, PublishedTable

FOLDER = "published"
BUNDLED = Path(slamhive.__file__).parent / FOLDER
_MOST_BYTES = 2**22


@dataclass(frozen=True)
class Published:
    """A published row, on a dataset that is known here.

    Attributes:
        dataset: the dataset's name here.
        row, table, source: what was published.
        values: numbers in stored units, by column.
        differences: why own numbers may differ, a sentence each.
    """

    dataset: str
    row: PublishedRow
    table: PublishedTable
    source: PublishedSource
    values: dict[str, float]
    differences: tuple[str, ...] = ()

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
        }


def read_published(path: Path) -> PublishedNumbers:
    """Read a file of published numbers.

    Raises:
        InputError: it can't be read, or isn't one; names the field.
    """
    try:
        with path.open("rb") as file:
            text = file.read(_MOST_BYTES + 1)
        if len(text) > _MOST_BYTES:
            raise InputError(f"{path}: more than {_MOST_BYTES >> 20} MiB")
        content = yaml.safe_load(text)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
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
    return numbers


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
    """Return the published rows on the datasets of some runs, with why own numbers may differ.

    A sequence is a dataset of the runs if their names are equal but for case and punctuation, if the dataset
    is called FAMILY-SEQUENCE by a family of the file, or if its attribute ``sequence`` is the sequence.

    Args:
        frame: the runs, one row a run and evaluation.
        known: all published numbers.
    """
    names = _identities(frame)
    own: dict[str, _Own] = {}
    found = []
    for numbers in known:
        families = {name: family for family, members in numbers.families.items() for name in members}
        for table in numbers.tables:
            for row in table.rows:
                family = families.get(row.dataset)
                meant = [plain_name(row.dataset)]
                meant += [plain_name(f"{family}-{row.dataset}")] if family else []
                dataset = next((names[name] for name in meant if name in names), None)
                if dataset is None:
                    continue
                if dataset not in own:
                    own[dataset] = _Own.of(frame, dataset)
                values = {name: value / _metric(table, name).factor for name, value in row.values.items()}
                why = tuple(_differences(table, row, own[dataset]))
                found.append(Published(dataset, row, table, numbers.source, values, why))
    return found


def plain_name(name: str) -> str:
    """Return a name of a sequence without case and punctuation: ``MH_01_easy`` is ``mh-01-easy``."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def table_of(found: Sequence[Published], metrics: Sequence[Metric]) -> tuple[list[str], list[list[str]]]:
    """Return headings and lines of a table of published rows that have one of the metrics."""
    headings = ["published", "system", "sensors", "settings", "dataset", *(one.title for one in metrics)]
    lines = []
    for item in found:
        if not any(metric.column in item.values for metric in metrics):
            continue
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
                _statistic(table),
                str(table.alignment or "not said"),
                row.notes or "",
            ]
        )
    return [*headings, "of", "alignment", "notes"], lines


def differences_of(found: Iterable[Published]) -> list[str]:
    """Return the reasons that own numbers may differ from published ones, each once."""
    return list(dict.fromkeys(sentence for item in found for sentence in item.differences))


@dataclass(frozen=True)
class _Own:
    """Alignments of own results on a dataset, compared with those of published ones."""

    alignments: frozenset[str]

    @classmethod
    def of(cls, frame: Frame, dataset: str) -> _Own:
        places = [k for k, name in enumerate(frame.column("dataset").tolist()) if name == dataset]
        alignments = frame.column("alignment").tolist()
        known = [str(alignments[k]) for k in places if alignments[k] is not None]
        return cls(frozenset(known))


def _differences(table: PublishedTable, row: PublishedRow, own: _Own) -> Iterable[str]:
    """Say what may make own numbers differ; what is known of both is compared."""
    where = table.place
    if table.alignment is None:
        yield f"{where}: the alignment isn't said; SE(3) keeps errors of scale, Sim(3) takes them out"
    elif own.alignments and str(table.alignment).lower() not in {one.lower() for one in own.alignments}:
        yield (
            f"{where}: aligned by {table.alignment}, own runs by {', '.join(sorted(own.alignments))}; "
            "measure them alike by an Evaluation"
        )
    yield (
        f"{where}: measured are {table.poses}; own runs are measured at every pose that they wrote"
        if table.poses
        else f"{where}: whether keyframes or all poses are measured isn't said, nor whether they are causal "
        "or final ones"
    )
    if table.statistic is PublishedStatistic.BEST:
        yield f"{where}: the best of {table.runs or 'several'} runs; own tables have means and medians"
    elif table.runs == 1:
        yield f"{where}: a single run; its spread isn't known"
    if table.frame is not None:
        yield f"{where}: poses of the {table.frame}; own runs are measured in the frame that they wrote"
    yield (
        f"{where}: against {table.truth}"
        if table.truth
        else f"{where}: against the publishers' ground truth of that time; was it corrected since?"
    )
    if row.notes:
        yield f"{where}, {row.system} on {row.dataset}: {row.notes}"


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
