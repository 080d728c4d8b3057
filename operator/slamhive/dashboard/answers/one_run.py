# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/runs/UID``: all that is known of one run, and its files."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from slamhive.analysis.grouping import CHOSEN, SEARCHED, SUBJECT, varying, where_equal
from slamhive.analysis.measuring import outdated_note
from slamhive.analysis.metrics import declared_units, label_of
from slamhive.contract.environment import SETTINGS_FOLDER
from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.answers.columns import group_of, heading
from slamhive.dashboard.problems import BadRequest, Missing
from slamhive.model.errors import suggestion
from slamhive.model.sensors import SensorMode
from slamhive.model.templates import FILES_LIMIT
from slamhive.runfiles.clocks import CONFIGURATIONS, LATENCIES, clock_of, configuration_of, sensor_times
from slamhive.runfiles.errors import FileAwayError, FileMissingError, FileTooLargeError
from slamhive.runfiles.trajectories import (
    TRAJECTORIES,
    USAGES,
    drawn,
    extrinsic_of,
    read_poses,
    usage_columns,
)
from slamhive.tables.manifests import run_manifest
from slamhive.tables.timeliness import causal_result, late_note
from slamhive.tables.words import disproportion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from slamhive.archive.records import CatalogEntry
    from slamhive.dashboard.sources.archived import Snapshot, Source
    from slamhive.model.results import Result, RunRecord, Usage
    from slamhive.runfiles.artifacts import ArtifactFolder
    from slamhive.runfiles.ground_truth import DatasetTruth

_WITH_CAMERAS = frozenset(str(mode) for mode in SensorMode if mode.has_cameras)
_PARTS = ("usage", "frames", "trajectory")
_SETTINGS = (f"{SETTINGS_FOLDER}/", f"run/{SETTINGS_FOLDER}/")
DRAWN = (*TRAJECTORIES, *CONFIGURATIONS)
"""Files of a run that its path is drawn from, of which one of each kind is there."""

WANTED_OF_USAGE = (*USAGES, *CONFIGURATIONS, *LATENCIES)
"""Files of a run that its usage is shown from."""

MOST_SETTINGS = 1 << 17
"""Bytes of a settings file that is shown."""


def find(source: Source, uid: str) -> RunRecord:
    """Return a run.

    Raises:
        Missing: there is none of this UID.
    """
    record = source.record(uid) if len(uid) <= 253 else None
    if record is None:
        raise Missing(f"there is no run with the UID {uid[:100]!r}", "uid")
    return record


@dataclass(frozen=True)
class FoundRun:
    """A run, and its folder or why that is not here.

    Attributes:
        record: the run.
        place: its folder.
        absence: part of a sentence on why there is none, where that is known.
        trouble: why it can't be had at present.
    """

    record: RunRecord
    place: ArtifactFolder | None
    absence: str | None = None
    trouble: FileAwayError | None = None

    @property
    def folder(self) -> ArtifactFolder:
        """Return its folder.

        Raises:
            Missing: it is not here.
            FileAwayError: it can't be had at present.
        """
        if self.trouble is not None:
            raise self.trouble
        if self.place is None:
            reused = self.record.provenance.reused_from
            where = "its result was taken over from an equal run" if reused else "none is here"
            raise Missing(f"the run {self.record.name} has no files: {self.absence or where}", "uid")
        return self.place


def found(
    source: Source, uid: str, wanted: Callable[[ArtifactFolder], Iterable[str]] | None = None
) -> FoundRun:
    """Return a run with its folder, and have the files at hand that are read of it.

    Args:
        source: the data.
        uid: the run's.
        wanted: returns the paths of files that the answer is made of.

    Raises:
        Missing: there is no such run.
    """
    record = find(source, uid)
    try:
        place = source.place(record)
        if place is not None and wanted is not None:
            place.bring(wanted(place))
    except FileAwayError as error:
        return FoundRun(record, None, trouble=error)
    return FoundRun(record, place, source.absence(record))


@dataclass(frozen=True)
class RunsAlike:
    """Common parts of the answers on all runs, or on those of one subject.

    Attributes:
        varied: headings of the settings by which runs of a subject differ, by the subject.
        labelled: names of columns of costs and frames.
    """

    varied: dict[tuple[Any, ...], list[dict[str, Any]]] = field(default_factory=dict)
    labelled: dict[str, str] = field(default_factory=dict)


def detail(snapshot: Snapshot, found: FoundRun, alike: RunsAlike | None = None) -> Body:
    """Return a run with its configuration, provenance, usage, results and log.

    Args:
        snapshot: the data.
        found: the run.
        alike: what is known of others of the same snapshot already; it is filled.
    """
    alike = RunsAlike() if alike is None else alike
    record = found.record
    spec = record.spec
    plain = record.as_json()
    configuration = {
        "algorithm": (spec.get("algorithmRef") or {}).get("name"),
        "dataset": (spec.get("datasetRef") or {}).get("name"),
        **{name: spec.get(name) for name in ("sensors", "repetition", "seed")},
        **{name: spec.get(name) or {} for name in ("parameters", "input", "resources")},
    }
    varied, labelled = shared(snapshot, tuple(configuration[name] for name in SUBJECT), alike)
    content: dict[str, Any] = {
        "revision": snapshot.revision,
        "uid": record.uid,
        "name": record.name,
        "run": record.labels.get("run", record.name),
        "sweep": record.sweep,
        "index": record.index,
        **{name: plain.get(name) for name in ("phase", "reason", "message", "attempts")},
        **{name: plain.get(name) for name in ("created", "started", "finished")},
        "configuration": configuration,
        "varied": varied,
        "cameras": spec.get("sensors") in _WITH_CAMERAS,
        "note": record.note,
        "tags": record.tags,
        "attributes": record.attributes,
        "labels": record.labels,
        "metrics": record.metrics,
        "labelled": labelled,
        **{name: plain.get(name) for name in _PARTS},
        "provenance": plain.get("provenance") or {},
        "results": [_result_json(causal_result(record, result)) for result in record.results],
        "notes": [
            *filter(None, [late_note(record), _chosen_note(snapshot, record)]),
            *(note for result in record.results for note in _notes(result)),
        ],
        "logTail": record.log_tail,
        "manifest": run_manifest(record),
        # Where object storage does not answer, each of them says so.
        "files": found.place is not None or found.trouble is not None,
        "absence": found.absence,
        "links": {
            name: f"/api/v1/runs/{record.uid}/{name}" for name in ("manifest", "files", "trajectory", "usage")
        },
    }
    return Body(content)


def _chosen_note(snapshot: Snapshot, record: RunRecord) -> str | None:
    """Return a sentence on a run that a search chose by results; None for others."""
    frame = snapshot.frame
    if frame.column(SEARCHED).is_empty:
        return None
    method = frame.select(where_equal(frame, "uid", record.uid)).column(SEARCHED).tolist()[:1]
    told = f"{CHOSEN} a search ({method[0]}) chose this run by the results of others: it is no fair sample"
    return told if any(method) else None


def shared(
    snapshot: Snapshot, subject: tuple[Any, ...], alike: RunsAlike
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Return the parts that answers on runs of an algorithm and mode on a dataset have in common.

    Args:
        snapshot: the data.
        subject: the three.
        alike: what is known already; it is filled.
    """
    if subject not in alike.varied:
        same = snapshot.frame
        for name, value in zip(SUBJECT, subject, strict=True):
            same = same.select(where_equal(same, name, value))
        alike.varied[subject] = [heading(snapshot.frame, name) for name in varying(same)]
    if not alike.labelled:
        alike.labelled.update(_labelled(snapshot))
    return alike.varied[subject], alike.labelled


def _labelled(snapshot: Snapshot) -> dict[str, str]:
    """Return the names of columns of costs and frames; sizes are written with a unit of their own."""
    columns = [name for name in snapshot.frame.stored if name.startswith(("usage.", "frames.", "metrics."))]
    with declared_units(snapshot.frame.units):
        told = {name: label_of(name, "" if name.endswith("Bytes") else None) for name in columns}
    changed = {name: text for name, text in told.items() if text != name}
    return {name: text.removeprefix(f"{group_of(name)}.") for name, text in changed.items()}


def _result_json(result: Result) -> dict[str, Any]:
    return result.values | {
        "evaluation": result.evaluation,
        "outcome": result.outcome.value,
        "coverage": result.coverage,
    }


def _notes(result: Result) -> list[str]:
    """Return the sentences on a result, with its evaluation before each."""
    said = result.values.get("notes")
    notes = [outdated_note(result.values), disproportion(result), *(said if isinstance(said, list) else ())]
    return [f"{result.evaluation}: {note}" for note in notes if note]


def files(snapshot: Snapshot, found: FoundRun) -> Body:
    """Return the list of a run's files."""
    items = found.folder.files()
    names = ("path", "size", "modified")
    return Body(
        {"revision": snapshot.revision, "items": items},
        lambda: {name: [item[name] for item in items] for name in names},
    )


def settings_files(snapshot: Snapshot, found: FoundRun) -> Body:
    """Return the settings files that were rendered for a run, with their texts as far as they are short."""
    place = found.folder
    items = [
        {
            "path": _below_settings(str(item["path"])),
            "file": item["path"],
            "size": item["size"],
            "text": _text(place, item),
        }
        for item in _settings_of(place)
    ]
    return Body({"revision": snapshot.revision, "items": items})


def wanted_settings(place: ArtifactFolder) -> list[str]:
    """Return the paths of the settings files that are shown."""
    return [str(item["path"]) for item in _settings_of(place) if item["size"] <= MOST_SETTINGS]


def _settings_of(place: ArtifactFolder) -> list[dict[str, Any]]:
    return [item for item in place.files() if _below_settings(str(item["path"])) is not None][:FILES_LIMIT]


def _below_settings(path: str) -> str | None:
    """Return a file's path below the folder of settings files, None where it is elsewhere."""
    for prefix in _SETTINGS:
        if path.startswith(prefix):
            return path.removeprefix(prefix)
    return None


def _text(place: ArtifactFolder, item: dict[str, Any]) -> str | None:
    try:
        return place.read(str(item["path"]), MOST_SETTINGS).decode("utf-8", "replace")
    except (FileMissingError, FileTooLargeError):  # it may have gone or grown since
        return None


@dataclass(frozen=True)
class RunMaterial:
    """Record, folder and ground truth of a run, from which its trajectory is drawn.

    Attributes:
        record: the run.
        place: its folder.
        truth: ground truth of its dataset, if it is at hand.
        algorithms: versions of its Algorithm among others.
    """

    record: RunRecord
    place: ArtifactFolder
    truth: DatasetTruth | None
    algorithms: list[CatalogEntry]


def material(source: Source, uid: str) -> RunMaterial:
    """Look up what a run's path is drawn from.

    Raises:
        Missing: there is no such run, or its folder is not here.
    """
    seen = found(source, uid, lambda _: DRAWN)
    record, place = seen.record, seen.folder
    dataset = str((record.spec.get("datasetRef") or {}).get("name"))
    truth = source.truth(dataset, record.labels.get("dataset"))
    return RunMaterial(record, place, truth, source.catalog("Algorithm"))


def trajectory(snapshot: Snapshot, given: RunMaterial, evaluation: str | None, most: int) -> Body:
    """Return a run's aligned path over its ground truth, thinned, with errors and the dataset's clock."""
    record, truth = given.record, given.truth
    result = _chosen(record, evaluation)
    path = read_poses(given.place)
    configuration = configuration_of(given.place)
    extrinsic = extrinsic_of(record, configuration, given.algorithms, truth)
    cut = record.spec.get("input") or {}
    whole = not cut.get("start") and cut.get("duration") is None
    found = drawn(path, result, truth, extrinsic, most, whole=whole)
    clock = clock_of(configuration, truth, path.poses)
    answer = {"revision": snapshot.revision, "clock": clock and clock.as_json(), **found}
    return Body(answer, lambda: found["estimate"])


def _chosen(record: RunRecord, evaluation: str | None) -> Result | None:
    if evaluation is None:
        return record.results[0] if record.results else None
    for result in record.results:
        if result.evaluation == evaluation:
            return result
    names = [result.evaluation for result in record.results]
    raise BadRequest(
        f"unknown evaluation {evaluation[:100]!r}{suggestion(evaluation[:100], names)}", "evaluation"
    )


def usage(snapshot: Snapshot, found: FoundRun, most: int) -> Body:
    """Return CPU and memory over time, thinned: since the program's start, and by sensor time where known."""
    place = found.folder
    shown = usage_columns(place, most)
    configuration = configuration_of(place)
    shown["stamp"] = sensor_times(shown["t"], found.record, place, configuration)
    clock = clock_of(configuration) if shown["stamp"] is not None else None
    spent = found.record.usage
    shown["readerShare"] = spent and spent.reader_share
    shown["notes"] = _reader_notes(spent)
    names = ("t", "stamp", "cpu", "memory", "anonymous")
    columns = {key: shown[key] for key in names if shown[key] is not None}
    answer = {"revision": snapshot.revision, "clock": clock and clock.as_json(), **shown}
    return Body(answer, lambda: columns)


def _reader_notes(spent: Usage | None) -> list[str]:
    """Say that CPU over time, of which nothing can be taken out, holds the reading of the recording."""
    if spent is None or spent.reader_cpu_seconds is None:
        return ["CPU holds the reading of the recording, or may: its part isn't known"]
    if not spent.reader_share:
        return []
    share = f"{spent.reader_share:.0%} of all CPU seconds"
    return [f"CPU over time holds the reading of the recording, {share}; the run's figures are without it"]
