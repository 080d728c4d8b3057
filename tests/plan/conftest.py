# SPDX-License-Identifier: Apache-2.0
"""A small catalog and sweeps written as YAML."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.model.loading import parse, to_object
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, Plan

if TYPE_CHECKING:
    from collections.abc import Callable

CATALOG = """
apiVersion: slamhive.io/v1alpha1
kind: Algorithm
metadata: {name: scan-match, labels: {family: lidar}}
spec:
  image: none
  modes: [{name: lidar}]
  output: {frame: lidar}
  parameters:
    maxRange: {type: Number, default: 60.0, minimum: 1, maximum: 200, unit: m}
    voxelSize: {type: Number, nullable: true, minimum: 0.01}
    ICP.iterations: {type: Integer, default: 30, minimum: 1}
    deskew: {type: Boolean, default: true}
---
apiVersion: slamhive.io/v1alpha1
kind: Algorithm
metadata: {name: features, labels: {family: visual}}
spec:
  image: none
  modes: [{name: stereo}, {name: mono}]
  output: {frame: left}
  paces: [Realtime, Lockstep]
  realtime: {queue: 1}
  parameters:
    nFeatures: {type: Integer, default: 1000, minimum: 100, maximum: 10000}
    weights: {type: String, default: small, values: [small, large]}
---
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: hall, labels: {place: indoor}}
spec:
  recording: {synthetic: {sensors: [Lidar, Imu]}}
---
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: street, labels: {place: outdoor}}
spec:
  recording: {files: [{path: street.bag}]}
  sensors:
    left: {type: Camera, topic: /left}
    right: {type: Camera, topic: /right}
    top: {type: Lidar, topic: /points}
---
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: yard, labels: {place: outdoor}}
spec:
  recording: {files: [{path: yard.bag}]}
  sensors:
    lidar: {type: Lidar, topic: /points}
"""


def make_sweep(spec: str, name: str = "study") -> Sweep:
    text = f"apiVersion: slamhive.io/v1alpha1\nkind: Sweep\nmetadata: {{name: {name}}}\nspec:\n"
    text += "\n".join("  " + line for line in spec.strip("\n").splitlines())
    made = to_object(parse(text, "sweep.yaml")[0])
    assert isinstance(made, Sweep)
    return made


@pytest.fixture(scope="session")
def catalog() -> FixedCatalog:
    return FixedCatalog.of(to_object(document) for document in parse(CATALOG, "catalog.yaml"))


@pytest.fixture
def sweep() -> Callable[..., Sweep]:
    return make_sweep


@pytest.fixture
def plan(catalog: FixedCatalog) -> Callable[..., Plan]:
    def make(spec: str, *, strict: bool = True, name: str = "study") -> Plan:
        return Plan(make_sweep(spec, name), catalog, strict=strict)

    return make
