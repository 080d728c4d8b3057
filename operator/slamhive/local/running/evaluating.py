# SPDX-License-Identifier: Apache-2.0
"""Measuring the runs of a workstation, right after they end or again later with other settings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.analysis.measuring import is_current, settings_hash
from slamhive.analysis.subjects import Surroundings, subject_of
from slamhive.data.recordings.entries import file_sha256
from slamhive.local.home.removed import run_parts
from slamhive.model.errors import DataError, InputError, SystemFault
from slamhive.model.sensors import SensorMode
from slamhive.monitor.measuring.bounded import LimitError

if TYPE_CHECKING:
    from slamhive.analysis.measuring import Subject
    from slamhive.data.making.preparation import Variant
    from slamhive.data.store.groundtruth import GroundTruthPoses
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.evaluation import EvaluationSettings
    from slamhive.model.results import Result, RunRecord


class UnmeasurableError(InputError):
    """Measuring a run takes more than it may: so it would again."""


class TrajectoryEvaluator:
    """Measures trajectories against the ground truth of their datasets.

    Args:
        bench: what runs share.
    """

    def __init__(self, bench: Workbench) -> None:
        self._bench = bench

    def measure_file(  # noqa: PLR0917 - all that a result depends on
        self,
        path: Path,
        spec: dict[str, Any],
        settings: EvaluationSettings,
        variant: Variant | None = None,
        name: str | None = None,
        subject: Subject | None = None,
    ) -> Result | None:
        """Measure a trajectory file of a run.

        Args:
            path: the trajectory, in TUM format, a lost run's without a pose; with segments.csv beside it, it
                is measured map by map.
            spec: the run's resolved spec.
            settings: how to measure.
            variant: the prepared recording, when it is at hand.
            name: the evaluation's name; default: the alignment.
            subject: the evaluator's inputs, of a run that somebody else made.

        Returns:
            The result, or None when the dataset has no ground truth.

        Raises:
            InputError: the settings, the trajectory or the ground truth can't be used.
        """
        truth = self._bench.truth(spec["datasetRef"]["name"])
        if truth is None:
            return None
        subject = subject or self.subject(spec, truth, variant)
        key = spec["datasetRef"]["name"]
        try:
            found = self._bench.measuring.ask((path, key, settings, subject, name), **{key: truth.poses})
        except LimitError as error:
            if error.is_lasting:
                raise UnmeasurableError(f"can't be measured here: {error}") from None
            raise SystemFault(f"could not be measured: {error}") from None
        if isinstance(found, Exception):
            raise found
        result: Result = found
        return result

    def subject(
        self, spec: dict[str, Any], truth: GroundTruthPoses, variant: Variant | None = None
    ) -> Subject:
        """Return the evaluator's inputs for a run of this machine.

        Args:
            spec: the run's resolved spec.
            truth: its dataset's ground truth.
            variant: the prepared recording, when it is at hand.

        Raises:
            InputError: the algorithm or the recording can't be used.
        """
        algorithm = self._bench.workshop.algorithm(spec["algorithmRef"]["name"]).algorithm
        variant = variant or self._bench.prepare(spec, algorithm)
        dataset = self._bench.dataset(spec["datasetRef"]["name"]).dataset.spec
        given = Surroundings(
            truth_frame=truth.T_body_frame,
            by_role={role: sensor.T_body_sensor for role, sensor in variant.sensors.items()},
            by_name={sensor: found.T_body_sensor for sensor, found in dataset.sensors.items()}
            | {view.name: view.T_body_sensor for view in variant.sensors.values()},
            remap=spec["input"].get("remap"),
            gravity_aligned=dataset.has_level_truth,
            window=(variant.start_time, variant.start_time + variant.duration_seconds),
        )
        return subject_of(algorithm.spec, SensorMode(spec["sensors"]), given)

    def can_serve(self, twin: RunRecord, spec: dict[str, Any], settings: EvaluationSettings) -> bool:
        """Tell whether an equal run's results are under some settings, or can be measured so."""
        if not spec["evaluate"] or _fitting(twin, settings):
            return True
        return self.trajectory_of(twin) is not None

    def results_of_twin(
        self, twin: RunRecord, spec: dict[str, Any], settings: EvaluationSettings
    ) -> list[Result]:
        """Return an equal run's results under some settings, measured again if need be.

        Args:
            twin: the equal run.
            spec: the resolved spec of the run that takes them over.
            settings: how that one is measured.

        Raises:
            InputError: it can't be measured with these settings.
        """
        fitting = _fitting(twin, settings)
        path = self.trajectory_of(twin)
        if fitting or not spec["evaluate"] or path is None:
            return fitting
        result = self.measure_file(path, spec, settings)
        return [result] if result else []

    def trajectory_of(self, record: RunRecord) -> Path | None:
        """Return the trajectory that a run wrote; None when it is gone or another one lies in its place."""
        if not record.folder:
            return None
        parts = run_parts(record.folder)
        # The home may have been moved or copied since the record was written.
        moved = [self._bench.home.path.joinpath("runs", *parts)] if parts else []
        for place in (Path(record.folder), *moved):
            path = place / "run" / "output" / "trajectory.txt"
            try:
                # The run folder may hold a later attempt by now, or an edited file: the checksum decides.
                if record.trajectory and file_sha256(path) == record.trajectory.sha256:
                    return path
            except DataError:
                continue
        return None


def _fitting(twin: RunRecord, settings: EvaluationSettings) -> list[Result]:
    wanted = settings_hash(settings)
    return [result for result in twin.results if is_current(result.values, wanted)]
