# SPDX-License-Identifier: Apache-2.0
"""Suspects: stretches of ground truth that runs of different systems contradict together."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.model.results import Outcome
from slamhive.model.sensors import SensorMode
from slamhive.runfiles.clocks import configuration_of
from slamhive.runfiles.errors import RunFileError
from slamhive.runfiles.trajectories import extrinsic_of, read_poses
from slamhive_eval import EvaluationError
from slamhive_eval.measures.suspects import SystemEstimate, find_suspects

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.archive.records import CatalogEntry
    from slamhive.model.results import RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder
    from slamhive.runfiles.ground_truth import DatasetTruth
    from slamhive_eval import Trajectory
    from slamhive_eval.measures.suspects import Suspicion

MOST_RUNS = 5
"""Runs of a system whose files are read: they say the same of the ground truth, more or less."""


@dataclass(frozen=True)
class LocatedRun:
    """A run that tracked, and its files.

    Attributes:
        record: The run.
        place: Its folder; None where that isn't here.
        is_scaled: Whether it was aligned with a scale, as it has none of its own.
        absence: Why the folder isn't here; None where nobody knows.
    """

    record: RunRecord
    place: ArtifactFolder | None
    is_scaled: bool = False
    absence: str | None = None


@dataclass
class DatasetSuspects:
    """Suspects of one dataset's ground truth, or the reason that there can't be any.

    Attributes:
        dataset: Its name.
        runs: Number of runs whose poses were compared.
        found: The suspicion; None where ``why`` says the reason.
        why: Part of a sentence.
        left_out: A sentence for each run whose poses couldn't be had.
    """

    dataset: str
    runs: int = 0
    found: Suspicion | None = None
    why: str | None = None
    left_out: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Return the suspects as plain values."""
        return {
            "dataset": self.dataset,
            "runs": self.runs,
            "why": self.why,
            "leftOut": self.left_out,
            "found": None if self.found is None else self.found.as_dict(),
        }


TRACKED_COLUMNS = ("dataset", "algorithm", "uid", "outcome", "sensors")
"""Columns of a table of runs by which `tracked_systems` groups them."""


def tracked_systems(rows: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, dict[str, bool]]]:
    """Return the runs that tracked, by dataset, algorithm and UID: whether each has no scale of its own.

    Args:
        rows: Runs, with `TRACKED_COLUMNS`. A dataset is there without a run that tracked, too.
    """
    datasets: dict[str, dict[str, dict[str, bool]]] = {}
    for row in rows:
        systems = datasets.setdefault(str(row["dataset"]), {})
        if row["outcome"] == Outcome.TRACKED.value:
            runs = systems.setdefault(str(row["algorithm"]), {})
            runs.setdefault(str(row["uid"]), row["sensors"] == SensorMode.MONO)
    return datasets


def suspects_of(
    dataset: str,
    truth: DatasetTruth | None,
    systems: Mapping[str, Iterable[LocatedRun]],
    algorithms: list[CatalogEntry],
) -> DatasetSuspects:
    """Return the suspects of a dataset's ground truth.

    Args:
        dataset: Its name.
        truth: Its ground truth; None where that isn't at hand.
        systems: Its runs that tracked by system: the algorithm, whichever sensors it used. Of each as many
            are taken as are read.
        algorithms: Versions of the Algorithms in the archive, for whose pose a run wrote.
    """
    made = DatasetSuspects(dataset)
    if truth is None or truth.are_points:
        made.why = "its ground truth has no poses at hand here"
        return made
    estimates: dict[str, list[SystemEstimate]] = {}
    for system, runs in systems.items():
        known = estimates.setdefault(system, [])
        for run in runs:
            try:
                known.append(SystemEstimate(_in_truths_frame(run, truth, algorithms), run.is_scaled))
            except (RunFileError, EvaluationError) as error:
                made.left_out.append(f"{run.record.name}: {error}")
            if len(known) == MOST_RUNS:
                break
        made.runs += len(known)
    try:
        made.found = find_suspects(truth.poses, estimates)
    except EvaluationError as error:
        made.why = str(error)
    return made


def _in_truths_frame(run: LocatedRun, truth: DatasetTruth, algorithms: list[CatalogEntry]) -> Trajectory:
    """Return a run's poses as poses of the ground truth's frame.

    An estimate without a scale has no metric lever arm, and stays as it is.

    Raises:
        RunFileError: They can't be had.
    """
    if run.place is None:
        raise RunFileError(run.absence or "its folder is not here")
    poses = read_poses(run.place).poses
    if run.is_scaled:
        return poses
    extrinsic = extrinsic_of(run.record, configuration_of(run.place), algorithms, truth)
    return poses if extrinsic is None else poses.moved(np.linalg.inv(extrinsic).astype(np.float64))
