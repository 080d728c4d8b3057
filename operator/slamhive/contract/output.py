# SPDX-License-Identifier: Apache-2.0
"""Output folder of an algorithm, read once when the run has ended: the same part of summary.json anywhere.

The supervisor of a workstation and the sidecar of a pod read it once, when nothing of the run is left that
could change it; everyone else goes by what they say.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.contract.metrics import AlgorithmMetrics, frame_counts, keep_values, read_metrics
from slamhive.contract.posefiles import PoseFiles
from slamhive.contract.trajectory import FILE, TrajectoryCheck, check_trajectory

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.contract.metrics import Kept

ONLINE = "trajectory.online.txt"
"""In the output folder: each pose as it was first published."""
KEYFRAMES = "trajectory.keyframes.txt"
"""In the output folder: keyframes that a program wrote beside its trajectory, as the contract has poses."""


class OutputContents(NamedTuple):
    """Contents of an algorithm's output folder, read once when the run has ended.

    Attributes:
        metrics: What metrics.json holds.
        kept: What is recorded of it.
        trajectory: Whether trajectory.txt can be used.
        offered: Frames of its recording, None where nobody knows.
        keyframes: What was wrong with the keyframes beside the trajectory, None if nothing was.
        fault: What the machine refused while poses were converted, None if nothing: the algorithm is not to
            blame.
    """

    metrics: AlgorithmMetrics
    kept: Kept
    trajectory: TrajectoryCheck
    offered: int | None = None
    keyframes: str | None = None
    fault: str | None = None

    def metrics_problem(self, reader: str | None) -> str | None:
        """Return the sentences on the files beside the trajectory, metrics.json above all.

        Args:
            reader: What was wrong with what it says of the reader, or with all of the file.
        """
        said = (reader or self.metrics.note, self.kept.note, self.keyframes)
        return "; ".join(filter(None, said)) or None

    def as_json(self) -> dict[str, Any]:
        """Return the fields of summary.json."""
        return {
            "frames": frame_counts(self.metrics, self.offered),
            "metrics": self.kept.values,
            **self.trajectory.as_json(),
        }


def read_output(
    output_directory: str, offered: int | None = None, poses: Mapping[str, Any] | None = None
) -> OutputContents:
    """Read an output folder; whatever is there, this neither fails nor waits.

    Args:
        output_directory: Where the algorithm wrote.
        offered: Frames of its recording, None where nobody knows.
        poses: Files in which it writes its poses in its own way, as `PoseFiles.as_json` has them: they are
            converted.
    """
    metrics = read_metrics(output_directory)
    found, keyframes, fault = TrajectoryCheck(), None, None
    if poses is not None:
        from slamhive.contract.conversion import convert_all  # noqa: PLC0415 - memory that few runs need

        found, keyframes, fault = convert_all(output_directory, PoseFiles.from_json(poses), FILE, KEYFRAMES)
    if found.problem is None:
        found = check_trajectory(output_directory)
    return OutputContents(metrics, keep_values(metrics.values), found, offered, keyframes, fault)
