# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from slamhive.kube.api.kinds import OUR_KINDS, Key, Kind, key_of, reference

CRDS = Path(__file__).parents[2] / "crds"


@pytest.mark.parametrize(
    ("kind", "path"),
    [
        (Kind.MAPPING_RUN, "/apis/slamhive.io/v1alpha1/namespaces/lab/mappingruns/demo/status"),
        (Kind.JOB, "/apis/batch/v1/namespaces/lab/jobs/demo/status"),
        (Kind.POD, "/api/v1/namespaces/lab/pods/demo/status"),
    ],
)
def test_address_of_an_object(kind: Kind, path: str) -> None:
    assert kind.path("lab", "demo", "status") == path


def test_names_cannot_lead_elsewhere() -> None:
    assert Kind.POD.path("lab", "../x") == "/api/v1/namespaces/lab/pods/..%2Fx"


@pytest.mark.parametrize("kind", OUR_KINDS)
def test_our_kinds_are_those_of_the_crds(kind: Kind) -> None:
    spec = yaml.safe_load((CRDS / f"{kind.group}_{kind.plural}.yaml").read_text())["spec"]
    assert spec["group"] == kind.group
    assert spec["names"]["plural"] == kind.plural
    assert spec["names"]["kind"] == kind
    assert kind.version in [version["name"] for version in spec["versions"]]


def test_key_and_owner_reference() -> None:
    run = {"metadata": {"name": "demo", "namespace": "lab", "uid": "u1"}}
    assert str(key_of(Kind.MAPPING_RUN, run)) == "MappingRun lab/demo"
    assert key_of(Kind.MAPPING_RUN, run) == Key(Kind.MAPPING_RUN, "lab", "demo")
    assert reference(Kind.MAPPING_RUN, run, controller=True) == {
        "apiVersion": "slamhive.io/v1alpha1",
        "kind": "MappingRun",
        "name": "demo",
        "uid": "u1",
        "blockOwnerDeletion": False,
        "controller": True,
    }
