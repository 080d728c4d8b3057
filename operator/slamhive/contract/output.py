# SPDX-License-Identifier: Apache-2.0
"""Output folder of an algorithm, read once when the run has ended: the same part of summary.json anywhere.

The supervisor of a workstation and the sidecar of a pod read it once, when nothing of the run is left that
could change it; everyone else goes by what they say.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.contract.metrics import Metrics, frame_counts, keep_values, read_metrics
from slamhive.contract.trajectory import TrajectoryCheck, check_trajectory

if TYPE_CHECKING:
    from slamhive.contract.metrics import Kept


class Output(NamedTuple):
    """What an algorithm left.

    Attributes:
        metrics: What metrics.json holds.
        kept: What is recorded of it.
        trajectory: Whether trajectory.txt can be used.
        offered: Frames of its recording, None where nobody knows.
    """

    metrics: Metrics
    kept: Kept
    trajectory: TrajectoryCheck
    offered: int | None = None

    def metrics_problem(self, reader: str | None) -> str | None:
        """Return what is to be said of metrics.json.

        Args:
            reader: What was wrong with what it says of the reader, or with all of the file.
        """
        return "; ".join(filter(None, (reader or self.metrics.note, self.kept.note))) or None

    def as_json(self) -> dict[str, Any]:
        """Return the fields of summary.json."""
        return {
            "frames": frame_counts(self.metrics, self.offered),
            "metrics": self.kept.values,
            **self.trajectory.as_json(),
        }


def read_output(output_directory: str, offered: int | None = None) -> Output:
    """Read an output folder; whatever is there, this neither fails nor waits.

    Args:
        output_directory: Where the algorithm wrote.
        offered: Frames of its recording, None where nobody knows.
    """
    metrics = read_metrics(output_directory)
    return Output(metrics, keep_values(metrics.values), check_trajectory(output_directory), offered)
