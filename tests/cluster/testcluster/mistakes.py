# SPDX-License-Identifier: Apache-2.0
"""Manifests with one mistake each, and who says what of it: mistakes.yaml.

The models (`slamhive validate`, the operator) refuse every one. The API server refuses those that its schemas
and rules can tell; the others it stores, and the operator sets the condition Accepted=False.
"""

from __future__ import annotations

import copy
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

_TABLE = Path(__file__).resolve().parents[1] / "mistakes.yaml"
GOOD: dict[str, dict[str, Any]] = {
    "Algorithm": {
        "image": "example/odometry:1",
        "modes": [{"name": "lidar"}],
        "output": {"frame": "lidar"},
        "parameters": {"voxel": {"type": "Number", "default": 1.0, "minimum": 0.1}},
    },
    "Dataset": {
        "recording": {"files": [{"path": "a.bag"}]},
        "sensors": {"lidar": {"type": "Lidar", "topic": "/points"}},
        "groundTruth": {"file": "truth.txt"},
    },
    "Evaluation": {"runs": {"names": ["run"]}},
    "MappingRun": {"algorithmRef": {"name": "kiss-icp"}, "datasetRef": {"name": "synthetic-lidar"}},
    "Sweep": {
        "template": {"spec": {"datasetRef": {"name": "synthetic-lidar"}}},
        "matrix": [{"path": "algorithm", "values": ["kiss-icp"]}],
    },
}
"""A correct spec of each kind; the names are those of the catalog."""


@dataclass(frozen=True)
class Mistake:
    """One mistake.

    Attributes:
        kind: kind of the manifest.
        values: what is wrong with it: values by path below the spec, such as ``modes.0.name``.
        without: path of a field that is taken out.
        field: the field that the API server's sentence names; None where the server can't tell.
        server: words of that sentence.
        model: words of the models' sentence.
    """

    kind: str
    values: dict[str, Any]
    without: str | None
    field: str | None
    server: str
    model: str

    @property
    def label(self) -> str:
        """Return a name for the row."""
        shown = "-".join(f"{path}-{value}" for path, value in self.values.items())
        text = f"{self.kind}-{shown}" + (f"-no-{self.without}" if self.without else "")
        return re.sub("[^A-Za-z0-9.]+", "-", text)[:100].strip("-")

    def manifest(self, name: str) -> dict[str, Any]:
        """Return the wrong manifest."""
        body = manifest(self.kind, name)
        for path, value in self.values.items():
            put(body["spec"], path, value)
        if self.without is not None:
            *way, last = self.without.split(".")
            del _at(body["spec"], way)[last]
        return body


def manifest(kind: str, name: str) -> dict[str, Any]:
    """Return a correct manifest."""
    spec = copy.deepcopy(GOOD[kind])
    return {"apiVersion": "slamhive.io/v1alpha1", "kind": kind, "metadata": {"name": name}, "spec": spec}


def put(spec: dict[str, Any], path: str, value: Any) -> None:
    """Set a field of a spec; what is around it is made where it is missing."""
    *way, last = path.split(".")
    around = _at(spec, way)
    if isinstance(around, list):
        around[int(last) :] = [copy.deepcopy(value)]
    else:
        around[last] = copy.deepcopy(value)


def _at(spec: Any, way: list[str]) -> Any:
    for part in way:
        spec = spec[int(part)] if isinstance(spec, list) else spec.setdefault(part, {})
    return spec


def _read() -> tuple[Mistake, ...]:
    table = yaml.safe_load(_TABLE.read_text(encoding="utf-8"))
    return tuple(
        Mistake(
            kind=kind,
            values=row.get("set", {}),
            without=row.get("without"),
            field=row.get("field"),
            server=row.get("server", ""),
            model=row["model"],
        )
        for kind, rows in table.items()
        for row in rows
    )


MISTAKES = _read()
"""All of them."""
