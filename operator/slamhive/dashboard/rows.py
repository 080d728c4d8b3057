# SPDX-License-Identifier: Apache-2.0
"""What columns are made of, whether a run comes from the archive or from the cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.analysis.flattening import number_or_text

if TYPE_CHECKING:
    from collections.abc import Mapping

PREFIXES: tuple[tuple[str, str, str | None], ...] = (
    ("parameters", "spec", "parameters"),
    ("input", "spec", "input"),
    ("resources", "spec", "resources"),
    ("dataset.attributes", "attributes", None),
    ("label", "labels", None),
    ("metrics", "metrics", None),
    ("usage", "usage", None),
    ("frames", "frames", None),
    ("trajectory", "trajectory", None),
    ("provenance", "provenance", None),
)
"""(prefix of the columns, document, field of it) as ``flatten`` has them."""


def label_of_run(labels: Mapping[str, str] | None, name: str) -> int | float | str:
    """Return the column ``run``: the label of that name, else the run's name."""
    return number_or_text(labels["run"]) if labels and "run" in labels else name
