# SPDX-License-Identifier: Apache-2.0
"""Trajectories of somebody else as runs: measured as own ones are, without load, and never taken for them.

Their files may have any format that the evaluator reads. What is kept is TUM lines on the clock of the ground
truth, where own runs have theirs, with the address and the checksum of where they came from.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np

from slamhive.analysis.measuring import CPU_SECONDS, Subject, intended_evaluations, measure, method
from slamhive.analysis.subjects import SubjectItem
from slamhive.archive import CatalogEntry, SweepRecord
from slamhive.bridges.bundles.taking import foreign_name, place_files, require_label
from slamhive.bridges.slamhive1 import identify
from slamhive.contract.trajectory import FILE
from slamhive.data.recordings.entries import file_sha256
from slamhive.model.base import plain_name, seconds
from slamhive.model.canonical import digest
from slamhive.model.errors import DataError, InputError
from slamhive.model.results import Origin, OriginKind, Phase, Provenance, RunRecord, TrajectoryInfo
from slamhive.model.sensors import SensorMode
from slamhive.monitor.measuring.bounded import BoundedProcess, LimitError
from slamhive.monitor.measuring.hierarchy import memory_limit
from slamhive_eval import EvaluationError, Trajectory, match, read_trajectory, write_tum
from slamhive_eval.errors import AssociationError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from slamhive.data.store.groundtruth import GroundTruthPoses
    from slamhive.local.home.catalog import Workshop
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.evaluation import EvaluationSettings
    from slamhive.model.results import Result
    from slamhive_eval.formats.files import Format

_MEMORY_BYTES = 2 << 30
_ADDRESS = re.compile(r"https?://[^\s/]+(/\S*)?|doi:10\.\S+")
SWEEP = "trajectories"
"""Name of the sweep that they belong to, with a label behind it."""


@dataclass(frozen=True)
class TrajectoryOrder:
    """Description of trajectories that are taken in.

    Attributes:
        dataset, algorithm: what they are of.
        source: address of where they are from.
        sensors: mode of the algorithm.
        label: what the algorithm is told apart by.
        settings: how they are measured.
        frame: sensor of the dataset, or ``body``, whose poses they are; None: those of the ground truth's.
        offset: added to their stamps, s.
        form: format of the files; None to tell by the first line.
        times: file with the stamps of KITTI poses.
        parameters: settings that they were made with.
    """

    dataset: str
    algorithm: str
    source: str
    sensors: SensorMode
    label: str
    settings: EvaluationSettings
    frame: str | None = None
    offset: float = 0.0
    form: Format | None = None
    times: Path | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class TrajectoriesTaken:
    """Counts of trajectories that came, and what was wrong with the others.

    Attributes:
        added: runs that were new.
        evaluated: runs that got the evaluation asked for.
        unchanged: runs that had both.
        outcomes: how often each.
        problems: sentences.
    """

    added: int = 0
    evaluated: int = 0
    unchanged: int = 0
    outcomes: dict[str, int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def require_source(source: str) -> None:
    """Refuse what is no address.

    Raises:
        InputError: it is none.
    """
    if not _ADDRESS.fullmatch(source):
        raise InputError(f"{source!r}: expected an address, https://… or doi:10.…", "source")


def label_of(source: str) -> str:
    """Return the label of an address unless one is given: its server.

    >>> label_of("https://github.com/SLAM-Hive/results"), label_of("doi:10.5281/zenodo.123")
    ('github.com', 'doi-10.5281')
    """
    if source.startswith("doi:"):
        return f"doi-{source.removeprefix('doi:').partition('/')[0]}"
    return str(urlsplit(source).hostname)


def sensors_of(algorithm: str, workshop: Workshop, given: SensorMode | None) -> SensorMode:
    """Return the sensor mode of an algorithm: as given, by its manifest here, or by its name.

    Raises:
        InputError: nothing tells.
    """
    if given is not None:
        return given
    known = workshop.algorithms.get(algorithm)
    if known is not None and len(known.spec.modes) == 1:
        return known.spec.modes[0].name
    mode = identify(algorithm)[1]
    if mode is None:
        raise InputError(
            f"the sensors of {algorithm!r} aren't known; expected one of {', '.join(SensorMode)}", "sensors"
        )
    return mode


def take_trajectories(
    bench: Workbench,
    order: TrajectoryOrder,
    files: Sequence[Path],
    truth: GroundTruthPoses,
    *,
    dataset: CatalogEntry,
    step: Callable[[int, int], None] = lambda *_: None,
) -> TrajectoriesTaken:
    """Measure trajectories of a dataset and keep them as runs of somebody else.

    Args:
        bench: the home.
        order: what they are.
        files: the files; each is one repetition.
        truth: ground truth of the dataset.
        dataset: the dataset as it is known here.
        step: called with the number of files done, and of all.

    Raises:
        InputError: the settings don't fit, or the label is taken.
        SystemFault: the disk refuses.
    """
    return _TrajectoryTaking(bench, order, truth, dataset).take(files, step)


class _TrajectoryTaking:
    """Takes in trajectories, file by file."""

    def __init__(
        self, bench: Workbench, order: TrajectoryOrder, truth: GroundTruthPoses, dataset: CatalogEntry
    ) -> None:
        self._bench, self._order, self._truth, self._dataset = bench, order, truth, dataset
        archive = bench.archive
        require_label(archive, order.label, [order.algorithm], lambda one: one.source == order.source)
        self._subject = Subject(order.sensors, _extrinsic(bench, order, truth))
        self._evaluation = method(order.settings, self._subject)
        self._name = foreign_name(order.algorithm, order.label)
        self._sweep = SweepRecord(
            uid=digest([SWEEP, order.label])[:32],
            name=foreign_name(SWEEP, order.label),
            spec={},
            labels={"source": SWEEP},
        )
        self._known = {record.uid: record for record in archive.runs({"sweep_uid": self._sweep.uid})}
        self._checksum = bench.checksum(order.dataset) if order.dataset in bench.workshop.datasets else None

    def take(self, files: Sequence[Path], step: Callable[[int, int], None]) -> TrajectoriesTaken:
        """Take in files; a problem with one doesn't keep the others out."""
        found = TrajectoriesTaken()
        measuring = BoundedProcess(_measured, CPU_SECONDS, min(_MEMORY_BYTES, memory_limit() // 2))
        try:
            for number, path in enumerate(files):
                step(number, len(files))
                try:
                    self._take(path, measuring, found)
                except InputError as error:
                    found.problems.append(str(error))
        finally:
            measuring.close()
        return found

    def _take(self, path: Path, measuring: BoundedProcess, found: TrajectoriesTaken) -> None:
        order, archive = self._order, self._bench.archive
        sha256 = file_sha256(path)
        uid = digest(
            [order.label, order.algorithm, order.dataset, order.offset, dict(order.parameters), sha256]
        )
        intended = intended_evaluations(order.settings, order.sensors, None)
        known = self._known.get(uid[:32])
        if known is not None:
            self._require_same_reading(path, known, measuring)
            done = [one for one in known.results if one.evaluation == self._evaluation]
            if done:
                found.unchanged += 1
                _count(found, done[0])
                return
        result, trajectory = self._ask(path, measuring)
        found.evaluated += 1
        _count(found, result)
        if known is not None:
            archive.put_evaluations(known.uid, intended)
            archive.put_result(known.uid, result)
            return
        record = self._record(uid[:32], sha256).replace(evaluations=intended, results=[result])
        with tempfile.TemporaryDirectory(prefix="slamhive-import-") as folder:
            aside = Path(folder) / FILE
            write_tum(aside, trajectory)
            place_files(self._bench.home, Path(record.folder or ""), partial(shutil.copy, aside))
            info = TrajectoryInfo(
                poses=len(trajectory),
                duration_seconds=float(trajectory.stamps[-1] - trajectory.stamps[0]),
                sha256=file_sha256(aside),
                path=str(Path(record.folder or "") / "run" / "output" / FILE),
            )
        record = record.replace(trajectory=info)
        archive.put_sweep(self._sweep)
        archive.put_run(record, self._algorithm_entry(), self._dataset)
        self._known[record.uid] = record
        found.added += 1

    def _require_same_reading(self, path: Path, known: RunRecord, measuring: BoundedProcess) -> None:
        """Refuse a file that is there already and would have other poses as it is read now.

        Raises:
            InputError: it would.
        """
        order = self._order
        same = known.origin is None or known.origin.subject == SubjectItem.of(self._subject).as_json()
        if same and (order.form or order.times) and known.trajectory is not None:
            with tempfile.TemporaryDirectory(prefix="slamhive-import-") as folder:
                aside = Path(folder) / FILE
                write_tum(aside, self._ask(path, measuring)[1])
                same = file_sha256(aside) == known.trajectory.sha256
        if not same:
            raise DataError(
                f"{path}: is here already as {known.name}, read by another --format, --times, --frame or "
                f"--sensors; slamhive results prune --records --where \"run == '{known.name}'\" forgets it"
            )

    def _ask(self, path: Path, measuring: BoundedProcess) -> tuple[Result, Trajectory]:
        order = self._order
        asked = (path, order.form, order.times, order.offset, order.settings, self._subject)
        try:
            answer = measuring.ask(asked, truth=self._truth.poses)
        except LimitError as error:
            raise DataError(f"{path}: can't be measured here: {error}") from None
        if isinstance(answer, Exception):
            raise answer
        result, trajectory = answer
        return result, trajectory

    def _record(self, uid: str, sha256: str) -> RunRecord:
        order = self._order
        setting = (self._name, order.dataset, dict(order.parameters))
        taken = {
            int(one.spec.get("repetition", 0))
            for one in self._known.values()
            if (one.spec["algorithmRef"]["name"], one.spec["datasetRef"]["name"], one.spec["parameters"])
            == setting
        }
        repetition = next(number for number in range(len(taken) + 1) if number not in taken)
        name = plain_name(f"{order.algorithm[:24]}-{order.dataset[:24]}-{uid[:8]}")
        return RunRecord(
            uid=uid,
            name=name,
            sweep=self._sweep.name,
            sweep_uid=self._sweep.uid,
            spec={
                "algorithmRef": {"name": self._name},
                "datasetRef": {"name": order.dataset},
                "sensors": order.sensors.value,
                "parameters": dict(order.parameters),
                "repetition": repetition,
            },
            phase=Phase.SUCCEEDED,
            provenance=Provenance(dataset_sha256=self._checksum),
            folder=str(self._bench.home.path / "runs" / f"{SWEEP}@{order.label}" / name),
            origin=Origin(
                kind=OriginKind.TRAJECTORY,
                label=order.label,
                source=order.source,
                sha256=sha256,
                algorithm=order.algorithm,
                subject=SubjectItem.of(self._subject).as_json(),
            ),
        )

    def _algorithm_entry(self) -> CatalogEntry:
        return CatalogEntry(
            kind="Algorithm",
            name=self._name,
            labels={"source": SWEEP},
            spec={
                "description": f"{self._order.algorithm}, not run here: {self._order.source}",
                "homepage": self._order.source,
                "modes": [{"name": self._order.sensors.value}],
            },
        )


def _extrinsic(bench: Workbench, order: TrajectoryOrder, truth: GroundTruthPoses) -> Any:
    """Return the frame of the poses in that of the ground truth, (4, 4); None where they are the same."""
    if order.frame is None:
        return None
    frame = np.eye(4)
    if order.frame != "body":
        if order.dataset not in bench.workshop.datasets:
            told = f"of {order.dataset!r} there is ground truth alone, and no sensor {order.frame!r}"
            raise InputError(f"{told}; known: body", "frame")
        sensors = bench.dataset(order.dataset).dataset.spec.sensors
        if order.frame not in sensors:
            known = ", ".join(["body", *sensors])
            raise InputError(
                f"dataset {order.dataset!r} has no sensor {order.frame!r}; known: {known}", "frame"
            )
        frame = np.array(sensors[order.frame].T_body_sensor, dtype=np.float64)
    return np.linalg.inv(truth.T_body_frame) @ frame


def _count(found: TrajectoriesTaken, result: Result) -> None:
    found.outcomes[result.outcome.value] = found.outcomes.get(result.outcome.value, 0) + 1


def _measured(question: tuple[Any, ...], given: dict[str, Any]) -> tuple[Result, Trajectory] | Exception:
    """Read and measure a file, in the process that may be ended."""
    path, form, times, offset, settings, subject = question
    truth = given["truth"]
    try:
        estimate = _on_clock(read_trajectory(path, form, times=times, unsorted="sort"), truth)
        if offset:
            estimate = Trajectory(
                estimate.stamps + offset, estimate.positions, estimate.quaternions, oriented=estimate.oriented
            )
        if isinstance(truth, Trajectory):
            # Measured, it would be a lost run; but another clock says nothing of an algorithm.
            match(truth, estimate, max_difference_seconds=seconds(settings.association.max_difference))
        return measure(truth, estimate, settings, subject), estimate
    except AssociationError as error:
        return DataError(f"{path}: {error}{_offset_hint(estimate, truth, offset)}")
    except EvaluationError as error:
        told = str(error)
        return DataError(told if str(path) in told else f"{path}: {told}")
    except (InputError, OSError) as error:
        return DataError(f"{path}: {error}")


def _on_clock(estimate: Trajectory, truth: Any) -> Trajectory:
    """Return poses with stamps; those of KITTI are frames of the ground truth without a file of times.

    Raises:
        DataError: there are others than the ground truth has.
    """
    if estimate.stamped_by == "time":
        return estimate
    frames = estimate.stamps.astype(int)
    stamps = getattr(truth, "stamps", np.zeros(0))
    counted = estimate.stamped_by == "line" and len(frames) != len(stamps)
    if counted or frames.min() < 0 or frames.max() >= len(stamps):
        raise DataError(
            f"its {len(estimate)} poses have no time stamps, and the ground truth has {len(stamps)} poses: "
            "they can't be told by their number; --times FILE gives a stamp for each"
        )
    at = partial(Trajectory, stamps[frames], estimate.positions, estimate.quaternions)
    return at(rotations=estimate.rotations, oriented=estimate.oriented)


def _offset_hint(estimate: Trajectory, truth: Any, offset: float) -> str:
    """Say by how much stamps are off: by the nearest poses where both are of one time, else by the first."""
    stamps = getattr(truth, "stamps", None)
    if stamps is None:
        return ""
    begin, end = max(stamps[0], estimate.stamps[0]), min(stamps[-1], estimate.stamps[-1])
    if begin <= end:
        inside = estimate.stamps[(estimate.stamps >= begin) & (estimate.stamps <= end)]
        at = np.clip(np.searchsorted(stamps, inside), 1, len(stamps) - 1) if len(stamps) > 1 else None
        if at is not None and len(inside):
            before, after = stamps[at - 1] - inside, stamps[at] - inside
            nearest = float(np.median(np.where(np.abs(before) < after, before, after)))
            told = f"{nearest:+.6f} s off: --offset {offset + nearest:.6f} if that is a delay"
            return f"; the nearest one is {told}"
    first = float(stamps[0] - estimate.stamps[0])
    told = f"--offset {offset + first:.6f} if both begin at once"
    return f"; from first pose to first pose the offset is {first:+.6f} s: {told}"
