# SPDX-License-Identifier: Apache-2.0
"""Our kinds on a real API server: what it takes, what it refuses and in which words, what it shows."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from testcluster.mistakes import GOOD, MISTAKES, manifest, put
from typer.testing import CliRunner

from slamhive.cli.main import app
from slamhive.model.algorithm import TEXT_LIMIT
from slamhive.model.errors import InputError
from slamhive.model.loading import FROZEN as FROZEN_KINDS
from slamhive.model.loading import KINDS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from testcluster.access import Cluster
    from testcluster.mistakes import Mistake

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted([*ROOT.glob("examples/**/*.yaml"), *ROOT.glob("images/algorithms/*/algorithm.yaml")])
TOLD_BY_SERVER = [item for item in MISTAKES if item.field is not None]
UNTOLD = [item for item in MISTAKES if item.field is None]


def _label(mistake: Mistake) -> str:
    return mistake.label


Dry = Callable[[dict[str, Any]], tuple[bool, str]]


@pytest.fixture(scope="module")
def dry(crds: Cluster) -> Dry:
    """Asks the API server for an object that it doesn't keep, and returns whether and why it refuses.

    By one connection: 140 times kubectl take a minute, and say the same.
    """
    from kubernetes import client, config

    api = client.CustomObjectsApi(config.new_client_from_config(str(crds.kubeconfig)))

    def create(body: dict[str, Any]) -> tuple[bool, str]:
        group, _, version = body["apiVersion"].partition("/")
        place = group, version, "default", f"{body['kind'].lower()}s"
        asked = {"dry_run": "All", "field_validation": "Strict"}
        try:
            _, _, headers = api.create_namespaced_custom_object_with_http_info(*place, body, **asked)
        except client.ApiException as refusal:
            told = json.loads(refusal.body)
            causes = (told.get("details") or {}).get("causes") or ()
            lines = [f"{cause.get('field')}: {cause['message']}" for cause in causes]
            return True, "\n".join([told["message"], *lines])
        return False, headers.get("Warning", "")

    return create


def _validate(folder: Path, body: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the objections of `slamhive validate`, empty when it has none."""
    monkeypatch.setenv("SLAMHIVE_HOME", str(folder / "home"))
    path = folder / "manifest.json"
    path.write_text(json.dumps(body))
    result = CliRunner().invoke(app, ["validate", str(path)])
    if isinstance(result.exception, InputError):
        return str(result.exception)
    assert result.exit_code in {0, 2}, result.exception
    return " ".join(result.output.split()) if result.exit_code else ""


def test_the_table_is_long_and_covers_all_kinds() -> None:
    assert len(TOLD_BY_SERVER) >= 40
    assert {item.kind for item in TOLD_BY_SERVER} == set(KINDS)
    assert len({item.label for item in MISTAKES}) == len(MISTAKES)


@pytest.mark.parametrize("kind", GOOD)
def test_what_the_mistakes_are_made_in_is_right(
    dry: Dry, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert dry(manifest(kind, "right")) == (False, "")
    assert _validate(tmp_path, manifest(kind, "right"), monkeypatch) == ""


@pytest.mark.parametrize("mistake", TOLD_BY_SERVER, ids=_label)
def test_the_api_server_refuses(dry: Dry, mistake: Mistake) -> None:
    refused, text = dry(mistake.manifest("wrong"))
    assert refused
    assert any(mistake.field in line and mistake.server in line for line in text.splitlines()), text


@pytest.mark.parametrize("place", ["default", "values"])
def test_texts_of_parameters_have_a_length(dry: Dry, place: str) -> None:
    body = manifest("Algorithm", "long")
    for length, refused in ((TEXT_LIMIT, False), (TEXT_LIMIT + 1, True)):
        text = "x" * length
        values = {"default": text} | ({"values": [text]} if place == "values" else {})
        body["spec"]["parameters"] = {"note": {"type": "String"} | values}
        found, said = dry(body)
        assert found is refused
        assert not refused or f"parameters.note.{place}" in said


@pytest.mark.parametrize("mistake", UNTOLD, ids=_label)
def test_the_api_server_cannot_tell(dry: Dry, mistake: Mistake) -> None:
    assert dry(mistake.manifest("wrong")) == (False, "")


@pytest.mark.parametrize("mistake", MISTAKES, ids=_label)
def test_validate_refuses(mistake: Mistake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert mistake.model in _validate(tmp_path, mistake.manifest("wrong"), monkeypatch)


@pytest.mark.parametrize("kind", KINDS)
def test_names_are_short_enough_for_labels(dry: Dry, kind: str) -> None:
    refused, text = dry(manifest(kind, "a" * 64))
    assert refused
    assert "at most 63 characters" in text
    assert dry(manifest(kind, "a" * 63)) == (False, "")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_examples_apply_and_apply_again(crds: Cluster, namespace: str, path: Path) -> None:
    crds.kubectl("apply", "-n", namespace, "-f", str(path))
    crds.kubectl("apply", "-n", namespace, "-f", str(path))
    found = crds.get("slamhive", "-n", namespace)["items"]
    assert found
    assert {item["metadata"]["generation"] for item in found} == {1}


FROZEN = [
    ("Algorithm", "version", "2"),
    ("Algorithm", "parameters.voxel.default", 2.0),
    ("Dataset", "description", "another"),
    ("MappingRun", "seed", 2),
    ("MappingRun", "parameters", {"maxRange": 10}),
    ("MappingRun", "timeout", "2h"),
    ("Sweep", "repetitions", 2),
    ("Sweep", "matrix.0.values", ["genz-icp"]),
    ("Sweep", "template.spec.seed", 3),
    ("Sweep", "exclude", [{"algorithm": "kiss-icp"}]),
]
FREE = [
    ("MappingRun", "cancel", True),
    ("Sweep", "parallelism", 4),
    ("Sweep", "suspend", True),
    ("Sweep", "maxFailures", 3),
    ("Sweep", "budget", {"cpuHours": 2.0}),
    ("Sweep", "evaluation.alignment", "Origin"),
    ("Evaluation", "alignment", "Origin"),
]


def _edit(cluster: Cluster, namespace: str, kind: str, path: str, value: Any) -> tuple[int, str]:
    body = manifest(kind, "x")
    cluster.apply(body, namespace=namespace)
    put(body["spec"], path, value)
    result = cluster.run("apply", "--server-side", "-n", namespace, "-f", "-", stdin=json.dumps(body))
    return result.returncode, result.stderr


@pytest.mark.parametrize(("kind", "path", "value"), FROZEN)
def test_identity_cannot_change(crds: Cluster, namespace: str, kind: str, path: str, value: Any) -> None:
    code, text = _edit(crds, namespace, kind, path, value)
    assert code == 1
    field = "spec" if FROZEN_KINDS[kind] is None else f"spec.{path.partition('.')[0]}"
    assert f"{field}: Invalid value" in text
    assert f"cannot change once created; create another {kind} with a new name" in text


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("trials", 5, ""),
        ("trials", 3, "spec.search.trials: Invalid value"),
        ("seed", 1, "spec.search.seed: Invalid value"),
        ("method", "Sobol", "spec.search.method: Invalid value"),
        ("objectives", [{"metric": "rpe.rmse"}], "spec.search.objectives: Invalid value"),
    ],
)
def test_of_a_search_trials_may_be_raised(
    crds: Cluster, namespace: str, field: str, value: Any, told: str
) -> None:
    body = manifest("Sweep", "x")
    body["spec"]["search"] = {"method": "TPE", "objectives": [{"metric": "ate.rmse"}], "trials": 4}
    crds.apply(body, namespace=namespace)
    body["spec"]["search"][field] = value
    result = crds.run("apply", "--server-side", "-n", namespace, "-f", "-", stdin=json.dumps(body))
    assert (result.returncode, told in result.stderr) == (int(bool(told)), True)
    assert told or not result.stderr


@pytest.mark.parametrize(("kind", "path", "value"), FREE)
def test_the_rest_can_change(crds: Cluster, namespace: str, kind: str, path: str, value: Any) -> None:
    assert _edit(crds, namespace, kind, path, value) == (0, "")


def _undescribed(schema: dict[str, Any], way: str) -> Iterator[str]:
    for name, node in schema.get("properties", {}).items():
        if not node.get("description") and (way, name) != ("", "metadata"):
            yield f"{way}.{name}"
        yield from _undescribed(node, f"{way}.{name}")
    for key in ("items", "additionalProperties"):
        if key in schema:
            yield from _undescribed(schema[key], way)


@pytest.mark.parametrize("kind", KINDS)
def test_explain_tells_of_every_field(crds: Cluster, kind: str) -> None:
    crds.kubectl("explain", kind.lower(), "--recursive")
    served = crds.get("crd", f"{kind.lower()}s.slamhive.io")
    schema = served["spec"]["versions"][0]["schema"]["openAPIV3Schema"]
    assert list(_undescribed(schema, "")) == []


def test_explain_is_readable(crds: Cluster) -> None:
    text = crds.kubectl("explain", "sweep.spec.matrix")
    assert "exactly one of values, range, selector and points" in " ".join(text.split())
    assert "Longest time from the algorithm's first process" in crds.kubectl("explain", "mrun.spec.timeout")


STATUS = {
    "MappingRun": {
        "phase": "Succeeded",
        "display": {"ate": "0.034 m", "cpu": "0.81", "memory": "212 MiB"},
        "results": [{"evaluation": "default", "outcome": "Tracked", "coverage": 0.99}],
    },
    "Sweep": {
        "phase": "Running",
        "progress": "12/80",
        "running": 4,
        "failed": 1,
        "best": [{"name": "sweep-3f2a", "ate": 0.034}],
        "display": {"ate": "0.034 m"},
    },
}
COLUMNS = {
    "MappingRun": (
        "NAME PHASE ALGORITHM DATASET OUTCOME ATE CPU MEMORY AGE",
        "x Succeeded kiss-icp synthetic-lidar Tracked 0.034 m 0.81 212 MiB",
    ),
    "Sweep": (
        "NAME PHASE DONE IN-FLIGHT LINE ENDS FAILED BEST ATE AGE",
        "x Running 12/80 4 1 sweep-3f2a 0.034 m",
    ),
}


@pytest.mark.parametrize("kind", COLUMNS)
def test_columns_say_how_it_stands(crds: Cluster, namespace: str, kind: str) -> None:
    crds.apply(manifest(kind, "x"), namespace=namespace)
    status = json.dumps({"status": STATUS[kind]})
    way = ["patch", kind.lower(), "x", "-n", namespace, "--subresource=status", "--type=merge", "-p", status]
    crds.kubectl(*way)
    head, row = crds.kubectl("get", kind.lower(), "-n", namespace).splitlines()
    assert " ".join(head.split()) == COLUMNS[kind][0]
    assert " ".join(row.split()).startswith(COLUMNS[kind][1])


def test_all_kinds_are_found_by_category_and_short_name(crds: Cluster, namespace: str) -> None:
    for kind in KINDS:
        crds.apply(manifest(kind, "x"), namespace=namespace)
    named = crds.kubectl("get", "slamhive", "-n", namespace, "-o", "name").split()
    assert named == [f"{kind.lower()}.slamhive.io/x" for kind in KINDS]
    for short in ("algo", "dset", "eval", "mrun", "sw"):
        assert crds.kubectl("get", short, "-n", namespace, "-o", "name").count("/x") == 1
