# SPDX-License-Identifier: Apache-2.0
"""Rerun: a recording a dataset, in layers: a file for the ground truth and one for each run.

Errors are against the ground truth in the frame that a run's estimate is of, so that there may be several.
"""

from __future__ import annotations

import colorsys
import hashlib
import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slamhive.bridges.gathering import FittedNames, plain
from slamhive.model.canonical import digest
from slamhive.model.extras import library
from slamhive.runfiles.clocks import configuration_of, sensor_times
from slamhive.runfiles.errors import FileMissingError, FileTooLargeError
from slamhive.runfiles.trajectories import drawn, extrinsic_of, read_poses, usage_columns

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.bridges.gathering import Handed
    from slamhive.bridges.places import Here
    from slamhive.model.results import Result, RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder

APPLICATION = "slamhive"
MARK = "slamhive.json"
NEXT = "rerun {folder}/DATASET/*.rrd"
TRUTH, LAYOUT = "groundtruth", "layout"
MOST_POSES = 20_000
"""Poses and samples of usage that are shown."""
LINE = "sensor time"
_SINCE = "since start"
_TRUTH, ESTIMATE = (120, 120, 120), (230, 120, 20)
_FORMAT = 1
"""Number of what a layer holds: a change makes all of them anew."""
_GOLDEN = 0.618034
_NOTHING = (FileMissingError, FileTooLargeError)

Colour = tuple[int, int, int]


class _RunLayer(NamedTuple):
    """A run's part of a recording: its path over the ground truth, its load and what is missing."""

    path: dict[str, Any] | None
    usage: dict[str, Any] | None
    stamps: Any
    notes: list[str]

    def digest(self) -> str:
        """Hash of what is drawn of the run itself."""
        stamps = None if self.stamps is None else {"stamps": self.stamps}
        return _digest((self.path or {}).get("estimate"), self.usage, stamps)

    @property
    def reference(self) -> dict[str, Any] | None:
        """Ground truth that errors are against, if it is at hand."""
        return self.path["reference"] if self.path else None


def _digest(*parts: dict[str, Any] | None) -> str:
    total = hashlib.sha256(str(_FORMAT).encode())
    for columns in parts:
        for name, values in sorted((columns or {}).items()):
            if isinstance(values, np.ndarray):
                total.update(name.encode() + values.tobytes())
    return total.hexdigest()


def layer_of(record: RunRecord, here: Here, place: ArtifactFolder, result: Result | None) -> _RunLayer:
    """Read what there is to show of a run.

    Args:
        record: the run.
        here: where its files are.
        place: its folder.
        result: the evaluation whose alignment and errors are shown.
    """
    notes: list[str] = []
    configuration = configuration_of(place)
    truth = here.truth(record)
    path = usage = stamps = None
    try:
        extrinsic = extrinsic_of(record, configuration, here.algorithms(), truth)
        path = drawn(read_poses(place), result, truth, extrinsic, MOST_POSES)
        notes += path["notes"]
    except _NOTHING as error:
        notes.append(str(error))
    try:
        usage = usage_columns(place, MOST_POSES)
        stamps = sensor_times(usage["t"], record, place, configuration)
    except _NOTHING as error:
        notes.append(str(error))
    return _RunLayer(path, usage, stamps, notes)


class RerunRecorder:
    """Puts what is found of a run into a recording of Rerun's.

    Args:
        rr: the library.
        stream: the recording.
        run: part of the names of what is the run's own; empty where the recording has one run.
        colour: of its path.
    """

    def __init__(self, rr: Any, stream: Any, run: str = "", colour: Colour = ESTIMATE) -> None:
        self._rr = rr
        self._stream = stream
        self._run = run
        self._colour = colour

    def truth(self, columns: dict[str, Any], name: str = "truth") -> None:
        """Show the ground truth."""
        self._path(f"world/{name}", columns, _TRUTH)

    def layer(self, layer: _RunLayer) -> None:
        """Show a run's path, errors and load over time; load by sensor time where that is known."""
        self._stream.log("world", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if layer.path is not None:
            estimate = layer.path["estimate"]
            self._path(f"world/{self._run or 'estimate'}", estimate, self._colour)
            known = ~np.isnan(estimate["error"])
            if known.any():
                self._series("error_metres", estimate["t"][known], estimate["error"][known])
        if layer.usage is not None:
            known_time = layer.stamps is not None
            times, line = (layer.stamps, LINE) if known_time else (layer.usage["t"], _SINCE)
            self._series("usage/cpu_cores", times, layer.usage["cpu"], line)
            self._series("usage/memory_mebibytes", times, layer.usage["memory"] / 2**20, line)

    def document(self, record: RunRecord, notes: list[str]) -> None:
        """Show what the run was, and what is missing of it."""
        spec = record.spec
        rows = [
            ("sweep", record.sweep),
            ("dataset", (spec.get("datasetRef") or {}).get("name")),
            ("algorithm", (spec.get("algorithmRef") or {}).get("name")),
            ("sensors", spec.get("sensors")),
            *(spec.get("parameters") or {}).items(),
            ("repetition", spec.get("repetition")),
            ("phase", record.phase),
            ("uid", record.uid),
        ]
        for result in record.results:
            ate = result.values.get("ate") or {}
            rows.append((f"ATE, {result.evaluation} [m]", ate.get("rmse")))
        text = "\n".join(f"| {name} | {value} |" for name, value in rows)
        table = "\n\n".join((f"| {record.name} | |\n|---|---|\n{text}", *notes))
        document = self._rr.TextDocument(table, media_type="text/markdown")
        self._stream.log(f"run/{self._run}".rstrip("/"), document, static=True)

    def layout(self) -> None:
        """Show paths beside errors and loads of all runs: left to itself Rerun gives each run a tab."""
        views = library("rerun.blueprint", "rerun", "a layout")
        series = {"error [m]": "error_metres", "CPU [cores]": "usage/cpu_cores"}
        series["memory [MiB]"] = "usage/memory_mebibytes"
        curves = [views.TimeSeriesView(name=name, origin=place) for name, place in series.items()]
        paths = views.Spatial3DView(name="paths", origin="world")
        beside = views.Horizontal(paths, views.Vertical(*curves))
        self._stream.send_blueprint(views.Blueprint(beside, auto_views=False))

    def _path(self, name: str, columns: dict[str, Any], colour: Colour) -> None:
        """Show a path as a line, and where it is at each time as a point."""
        rr, stream = self._rr, self._stream
        points = np.stack([columns[axis] for axis in "xyz"], axis=1)
        stream.log(name, rr.LineStrips3D([points], colors=[colour]), static=True)
        stream.send_columns(
            f"{name}/pose", indexes=[self._times(columns["t"])], columns=rr.Points3D.columns(positions=points)
        )
        stream.log(f"{name}/pose", rr.Points3D.from_fields(colors=[colour], radii=[0.05]), static=True)

    def _series(self, name: str, times: Any, values: Any, line: str = LINE) -> None:
        place = f"{name}/{self._run}".rstrip("/")
        if self._run:
            look = self._rr.SeriesLines(colors=[self._colour], names=[self._run])
            self._stream.log(place, look, static=True)
        columns = self._rr.Scalars.columns(scalars=values)
        self._stream.send_columns(place, indexes=[self._times(times, line)], columns=columns)

    def _times(self, times: Any, line: str = LINE) -> Any:
        kind = "timestamp" if line == LINE else "duration"
        return self._rr.TimeColumn(line, **{kind: np.asarray(times, dtype=np.float64)})


class Writer:
    """Writes runs as layers of one recording a dataset; those that are there as they are now stay.

    Args:
        folder: the folder; each dataset gets one in it.
        source: where the runs' files are.

    Attributes:
        names: Rerun takes all.
        missing: sentences on what runs lack, with the number of runs.
    """

    names = FittedNames(str)

    def __init__(self, folder: Path, source: Here) -> None:
        self.missing: dict[str, int] = {}
        self._rr = library("rerun", "rerun", "--to rerun")
        self._folder = folder
        self._source = source

    def write(self, run: Handed) -> bool:
        """Write a run; tell whether anything was new."""
        record = self._source.record(run.uid)
        if record is None:
            raise FileMissingError(f"run {run.name}: the archive has it no more")
        place = self._source.place(record)
        result = next((one for one in record.results if one.evaluation in run.evaluations), None)
        if place is None:
            layer = _RunLayer(None, None, None, ["its files are not here"])
        else:
            layer = layer_of(record, self._source, place, result)
        for note in layer.notes:
            self.missing[note] = self.missing.get(note, 0) + 1

        folder = _DatasetLayers(
            self._rr, self._folder, run.tags.get("dataset", "unknown"), run.tags.get("dataset.version")
        )
        folder.write(LAYOUT, {"digest": str(_FORMAT)}, RerunRecorder.layout)
        truth = None
        if layer.reference is not None:
            seen = _digest(layer.reference)
            truth, columns = f"{TRUTH}-{seen[:8]}", layer.reference
            folder.write(truth, {"digest": seen}, lambda recorder: recorder.truth(columns, str(truth)))

        def fill(recorder: RerunRecorder) -> None:
            recorder.layer(layer)
            recorder.document(record, layer.notes)

        return folder.write(
            run.short, {"digest": digest([run.digest(), layer.digest(), layer.notes]), "truth": truth}, fill
        )

    def close(self) -> None:
        """Nothing is open between two runs."""


class _DatasetLayers:
    """The layers of a dataset: files, and a list of what each shows."""

    def __init__(self, rr: Any, folder: Path, dataset: str, version: str | None) -> None:
        self._rr = rr
        self._dataset = dataset
        self._identity = digest([dataset, version])
        self._path = folder / f"{plain(dataset)}-{self._identity[:8]}"
        self._path.mkdir(parents=True, exist_ok=True)
        self._marks = self._read()

    def _read(self) -> dict[str, dict[str, Any]]:
        try:
            found = json.loads((self._path / MARK).read_text(encoding="utf-8"))
            return {str(name): one | {"number": int(one["number"])} for name, one in found.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return {}

    def write(self, name: str, mark: dict[str, Any], fill: Callable[[RerunRecorder], None]) -> bool:
        """Write a layer unless it is there as it is now; tell whether it was written."""
        target = self._path / f"{name}.rrd"
        known = self._marks.get(name, {"number": len(self._marks)})
        mark = known | mark
        if known == mark and target.exists():
            return False
        with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=self._path) as aside:
            path = Path(aside) / target.name
            stream = self._rr.RecordingStream(APPLICATION, recording_id=self._identity)
            stream.save(str(path))
            stream.send_recording_name(self._dataset)
            fill(RerunRecorder(self._rr, stream, name, _colour(mark["number"])))
            stream.flush()
            stream.disconnect()
            path.replace(target)
            self._marks[name] = mark
            self._forget_truths()
            written = Path(aside) / MARK
            written.write_text(json.dumps(self._marks, indent=1), encoding="utf-8")
            written.replace(self._path / MARK)
        return True

    def _forget_truths(self) -> None:
        """Remove ground truth that no run is compared with any more."""
        runs = {name: mark for name, mark in self._marks.items() if "truth" in mark}
        used = {mark["truth"] for mark in runs.values()}
        newest = next(reversed(self._marks))
        for name in set(self._marks) - set(runs) - used - {newest, LAYOUT}:
            del self._marks[name]
            (self._path / f"{name}.rrd").unlink(missing_ok=True)


def _colour(number: int) -> Colour:
    """Give a colour far from those of the numbers before it."""
    red, green, blue = colorsys.hsv_to_rgb(number * _GOLDEN % 1, 0.8, 0.85)
    return round(255 * red), round(255 * green), round(255 * blue)
