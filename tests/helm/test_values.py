# SPDX-License-Identifier: Apache-2.0
"""The values' schema: complete, described, and refusing what is wrong with the field's name."""

from __future__ import annotations

import json
import re
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

if TYPE_CHECKING:
    from collections.abc import Iterator

CHARTS = Path(__file__).parents[2] / "helm"
NAMES = ["slamhive", "slamhive-crds"]
FREE = {
    *("operator.affinity", "runs.affinity", "dashboard.affinity", "global"),
    "volumes.results.offload.options",
}
"""Values that are handed on as Kubernetes, or fsspec, has them."""


def schema(chart: str) -> dict[str, Any]:
    return dict(json.loads((CHARTS / chart / "values.schema.json").read_text()))


def values(chart: str) -> dict[str, Any]:
    return dict(yaml.safe_load((CHARTS / chart / "values.yaml").read_text()))


def fields(
    node: dict[str, Any], root: dict[str, Any], path: str = ""
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every field that a schema describes, with the reference followed and the description kept."""
    for name, field in node.get("properties", {}).items():
        where = f"{path}.{name}".lstrip(".")
        target = reduce(getitem, field["$ref"].split("/")[1:], root) if "$ref" in field else {}
        whole = target | field
        yield where, whole
        yield from fields(whole, root, where)
        if isinstance(whole.get("items"), dict):
            yield from fields(whole["items"], root, f"{where}[]")


@pytest.mark.parametrize("chart", NAMES)
def test_every_field_is_described_and_closed(chart: str) -> None:
    root = schema(chart)
    assert root["additionalProperties"] is False
    for path, field in fields(root, root):
        assert field["description"].endswith("."), path
        if field.get("type") == "object":
            more = field.get("additionalProperties")
            assert more is False or isinstance(more, dict) or path in FREE, path
        if field.get("type") == "array":
            assert "items" in field, path


@pytest.mark.parametrize("chart", NAMES)
def test_values_and_schema_name_the_same(chart: str) -> None:
    root = schema(chart)
    known = {path: field for path, field in fields(root, root) if "[]" not in path}

    def leaves(node: dict[str, Any], path: str = "") -> Iterator[str]:
        for name, value in node.items():
            where = f"{path}.{name}".lstrip(".")
            yield where
            closed = known.get(where, {}).get("additionalProperties") is False
            if isinstance(value, dict) and closed and not where.endswith("resources"):
                yield from leaves(value, where)

    within = re.compile(r"(\.resources|affinity)\.")
    assert {*leaves(values(chart))} == {
        path for path in known if path != "global" and not within.search(path)
    }


@pytest.mark.parametrize("chart", NAMES)
def test_every_block_of_values_has_a_comment(chart: str) -> None:
    lines = (CHARTS / chart / "values.yaml").read_text().splitlines()
    begins = [number for number, line in enumerate(lines) if re.match(r"\w+:", line)]
    for begin, end in zip(begins, [*begins[1:], len(lines)], strict=True):
        assert "#" in lines[begin - 1] or any("  #" in line for line in lines[begin:end]), lines[begin]


WRONG = [
    ("colour=red", "colour"),
    ("fullnameOverride=Hive", "/fullnameOverride"),
    ("workspaces={a_b}", "/workspaces/0"),
    ("workspaces={a,a}", "/workspaces"),
    ("image.repository=", "/image/repository"),
    ("image.tag=a b", "/image/tag"),
    ("image.digest=sha256:12", "/image/digest"),
    ("image.pullPolicy=Sometimes", "/image/pullPolicy"),
    ("image.name=x", "'name'"),
    ("uid=0", "/uid"),
    ("uid=root", "/uid"),
    ("volumes.results.size=big", "/volumes/results/size"),
    ("volumes.results.accessModes={ReadOnlyMany}", "/volumes/results/accessModes/0"),
    ("volumes.results.accessModes=null,volumes.results.accessModes={}", "/volumes/results/accessModes"),
    ("volumes.data.keep=perhaps", "/volumes/data/keep"),
    ("volumes.data.local.path=here", "/volumes/data/local/path"),
    ("volumes.more.size=1Gi", "'more'"),
    ("volumes.results.offload.url=bucket", "/volumes/results/offload/url"),
    ("volumes.results.offload.url=file:///results", "/volumes/results/offload/url"),
    ("volumes.results.offload.full=0", "/volumes/results/offload/full"),
    ("volumes.results.offload.after=1day", "/volumes/results/offload/after"),
    ("volumes.data.offload.url=s3://a", "'offload'"),
    ("archive.existingSecret=My_Secret", "/archive/existingSecret"),
    ("archive.url=postgresql://a", "'url'"),
    ("settings.defaultParallelism=0", "/settings/defaultParallelism"),
    ("settings.evaluation.batchSize=201", "/settings/evaluation/batchSize"),
    ("settings.evaluation.memory=much", "/settings/evaluation/memory"),
    ("settings.preparation.timeout=long", "/settings/preparation/timeout"),
    ("settings.metrics.intervalSeconds=0", "/settings/metrics/intervalSeconds"),
    ("settings.metrics.port=9091", "'port'"),
    ("settings.workers=1000", "/settings/workers"),
    ("settings.logLevel=TRACE", "/settings/logLevel"),
    ("sharing.slots=0", "/sharing/slots"),
    ("sharing.waitingPods=0", "/sharing/waitingPods"),
    ("sharing.namespaces.lab.weight=1001", "/sharing/namespaces/lab/weight"),
    ("sharing.namespaces.lab.cpuHours=-1", "/sharing/namespaces/lab/cpuHours"),
    ("sharing.namespaces.lab.share=3", "'share'"),
    ("sharing.namespaces.A_b.weight=1", "'A_b'"),
    ("operator.resources.limit.cpu=1", "'limit'"),
    ("operator.replicas=2", "'replicas'"),
    ("runs.gpuResource=gpu", "/runs/gpuResource"),
    ("runs.tolerations[0].efect=NoSchedule", "'efect'"),
    ("runs.tolerations[0].effect=Never", "/runs/tolerations/0/effect"),
    ("collector.grace=1day", "/collector/grace"),
    ("collector.trash=1week", "/collector/trash"),
    ("collector.brake.percent=200", "/collector/brake/percent"),
    ("collector.schedule=daily", "/collector/schedule"),
    ("metrics.serviceMonitor.interval=15", "/metrics/serviceMonitor/interval"),
    ("networkPolicies.apiServer.ports={}", "/networkPolicies/apiServer/ports"),
    ("networkPolicies.apiServer.cidrs={10.0.0.1}", "/networkPolicies/apiServer/cidrs/0"),
    ("networkPolicies.dnsPorts={dns}", "/networkPolicies/dnsPorts/0"),
    ("dashboard.replicas=-1", "/dashboard/replicas"),
    ("dashboard.connectionsPerAddress=513", "/dashboard/connectionsPerAddress"),
    ("dashboard.service.type=Public", "/dashboard/service/type"),
    ("dashboard.ingress.host=a_b", "/dashboard/ingress/host"),
    ("dashboard.ingress.path=/hive", "'path'"),
    ("catalog.imageRegistry=https://a b", "/catalog/imageRegistry"),
    # What only the templates can tell:
    (
        "catalog.enabled=true,catalog.algorithms={kiss}",
        'catalog.algorithms: unknown name "kiss", allowed: ct-icp',
    ),
    (
        "archive.existingSecret=a,archive.sqlite.enabled=true",
        "archive: existingSecret and sqlite.enabled exclude",
    ),
    ("volumes.results.offload.url=s3://a", "volumes.results.offload.url: only runs that are in an archive"),
    (
        "archive.sqlite.enabled=true,volumes.results.offload.readSecret=a",
        "volumes.results.offload.readSecret: the offloader needs keys that may write",
    ),
    ("archive.readSecret=a", "archive.readSecret: the operator needs an account that may write"),
    ("workspaces={a},archive.sqlite.enabled=true", "archive.sqlite.enabled: a file can't be shared"),
    ("volumes.data.existingClaim=a,volumes.data.local.path=/b", "volumes.data: existingClaim and local.path"),
    ("volumes.data.storageClassName=a,volumes.data.local.path=/b", "volumes.data: local.path makes a volume"),
    ("dashboard.ingress.enabled=true", "dashboard.ingress.host: needed"),
]


@pytest.mark.parametrize(("settings", "told"), WRONG, ids=[settings for settings, _ in WRONG])
def test_wrong_values_are_refused_by_name(helm: Any, settings: str, told: str) -> None:
    message = helm.text("--set", settings.replace("accessModes=null,volumes.results.", ""), code=1)
    assert told in message
    assert "nil pointer" not in message


@pytest.mark.parametrize("settings", ["keep=perhaps", "labels.a=1", "crds=true", "aggregateRoles=2"])
def test_wrong_values_of_the_kinds_are_refused(helm: Any, settings: str) -> None:
    message = helm.text("--set", settings, chart=CHARTS / "slamhive-crds", code=1)
    assert settings.split("=", maxsplit=1)[0].replace(".", "/") in message


@pytest.mark.parametrize(
    "settings",
    ["operator.resources.limits.cpu=1", "settings.evaluation.cpu=0.5", "volumes.data.storageClassName="],
)
def test_values_that_look_odd_are_accepted(helm: Any, settings: str) -> None:
    assert helm.objects("--set", settings)
