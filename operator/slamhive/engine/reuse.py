# SPDX-License-Identifier: Apache-2.0
"""Reuse: what a run takes over from a finished one of equal content, on a workstation and on a cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from slamhive.model.results import RunRecord


def taken_over(equal: RunRecord, recording: Mapping[str, Any], processors: Collection[str]) -> dict[str, Any]:
    """Return the fields of a run's record that it has from an equal run; results are not among them.

    Args:
        equal: the finished run of the same content.
        recording: fields of the provenance that are the run's own: what it asked of its recording.
        processors: models of the processors that the run could have run on. CPU and memory that were
            measured on another are left out: they would stand beside figures that can't be compared.
    """
    measured_on = equal.provenance.cpu_model
    return {
        "usage": equal.usage if measured_on is not None and measured_on in processors else None,
        "frames": equal.frames,
        "metrics": equal.metrics,
        "trajectory": equal.trajectory,
        "folder": equal.folder,
        "log_tail": equal.log_tail,
        "started": equal.started,
        "finished": equal.finished,
        "provenance": equal.provenance.replace(
            reused_from=equal.provenance.reused_from or equal.name, **recording
        ),
    }
