# SPDX-License-Identifier: Apache-2.0
"""Tables of the ICRA 2023 paper on SLAM Hive, as published: over all runs but a few, tracked or not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.model.errors import UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Preset:
    """Rows, columns, metrics and choice of runs of a published table, to make it again.

    Attributes:
        rows, columns: names of columns, joined by commas.
        metrics: as ``Metric.parse`` reads them.
        evaluation, where: which runs.
        caption: what it is.
    """

    rows: str
    columns: str
    metrics: tuple[str, ...]
    evaluation: str
    where: str
    caption: str


_LOAD = ("usage.cpu.meanCores:.2f", "usage.cpu.maxCores:.2f", "usage.memory.peakBytes:MiB:.0f")

PRESETS: Mapping[str, Preset] = {
    "III": Preset(
        rows="sensors,algorithm",
        columns="dataset",
        metrics=("ate.rmse:m:.3f", *_LOAD),
        evaluation="sim3",
        where="dataset != 'rgbd-dataset-freiburg2-desk' and run not in (53, 103, 122)",
        caption="Accuracy, CPU and memory on EuRoC, as Table III of the ICRA 2023 paper on SLAM Hive.",
    ),
    "IV": Preset(
        rows="parameters.nFeatures",
        columns="",
        metrics=("ate.rmse:cm:.3f", "rpe[0].rmse:cm:.2f", *_LOAD),
        evaluation="sim3",
        where="dataset == 'rgbd-dataset-freiburg2-desk' and run not in (124, 139, 140)",
        caption=(
            "ORB-SLAM2 (RGB-D) on TUM fr2/desk with different numbers of features, "
            "as Table IV of the ICRA 2023 paper on SLAM Hive."
        ),
    ),
}
"""By the number that each has in the paper."""


def preset(name: str) -> Preset:
    """Return the table of a name; 3 and 4 are understood too.

    Raises:
        UnknownNameError: there is no such table.
    """
    found = PRESETS.get({"3": "III", "4": "IV"}.get(name, name.upper()))
    if found is None:
        raise UnknownNameError("table", name, PRESETS, argument="preset")
    return found
