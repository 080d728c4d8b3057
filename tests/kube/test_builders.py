# SPDX-License-Identifier: Apache-2.0
"""Manifests of Jobs: as they always were (golden), safe whatever users write, and within the API's limits.

``SLAMHIVE_UPDATE=1 pytest tests/kube/test_builders.py`` writes the golden manifests.
"""

from __future__ import annotations

import json
import os
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
import yaml

from slamhive.kube.api.kinds import Kind, reference
from slamhive.kube.builders import (
    ANNOTATION_LIMIT,
    Companion,
    batches,
    configuration,
    evaluator_job,
    evaluator_job_name,
    job_name,
    label_value,
    read_job,
    run_job,
    variant_job,
    variant_name,
)
from slamhive.kube.builders.common import passed_on
from slamhive.kube.builders.player import player
from slamhive.kube.builders.run import least_requests
from slamhive.kube.builders.sending import sender_job
from slamhive.kube.builders.variant import variant_request
from slamhive.kube.capacity import bound_by_nodes
from slamhive.kube.settings import PreparationJobs, Settings
from slamhive.model.algorithm import TEXT_LIMIT, Algorithm
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError
from slamhive.model.evaluation import Evaluator
from slamhive.model.run import InputOptions
from slamhive.model.sensors import SensorMode
from slamhive.monitor import SidecarSpec
from slamhive.plan import resolve

GOLDEN = Path(__file__).parent / "golden"
API = "slamhive.io/v1alpha1"
SHA = "b" * 64
UID = "1a041cf6-9b92-477e-a9c3-86376ca82111"
POD = "eaef8f1d-9f35-4770-a729-f01b7a293351"
SENSOR = {"type": "Lidar", "topic": "/points", "rate": 10, "lidar": {"rings": 32}}
DESCRIPTION: dict[str, Any] = {
    "folder": "0123abcd",
    "format": "Rosbag1",
    "recording": "recording.bag",
    "sensors": {"lidar": SENSOR | {"name": "lidar"}},
    "startTime": 1600000000.5,
    "durationSeconds": 26.0,
    "frameRate": 5.0,
    "resolution": 1.0,
    "frames": 131,
    "key": "0123abcd" * 8,
    "sourceSha256": SHA,
    "datasetSha256": SHA,
    "sizeBytes": 1024,
}
PODS = {
    "nodeSelector": {"pool": "slam"},
    "tolerations": [{"key": "slam", "operator": "Exists"}],
    "runtimeClassName": "nvidia",
    "imagePullSecrets": ["registry"],
    "priorityClassName": "low",
}


def algorithm(**spec: Any) -> Algorithm:
    body = {
        "image": "example.org/lio:1.0",
        "command": ["lio", "--config", "$(HOME)/x y; rm -rf $HOME"],
        "modes": [{"name": "lidar"}],
        "output": {"frame": "lidar"},
        "parameters": {"voxel.size": {"type": "Number", "default": 0.5}},
        "assets": [
            {"name": "weights/net.bin", "url": "https://example.org/net.bin", "sha256": "c" * 64},
            {"name": "vocabulary.txt", "path": "vocabulary.txt"},
        ],
    }
    return Algorithm.model_validate(
        {"apiVersion": API, "kind": "Algorithm", "metadata": {"name": "lio"}, "spec": body | spec}
    )


def dataset(name: str = "hall", **spec: Any) -> Dataset:
    body = {
        "recording": {"files": [{"path": "hall/a.bag"}]},
        "sensors": {"lidar": SENSOR},
        "gravityAligned": True,
    }
    return Dataset.model_validate(
        {"apiVersion": API, "kind": "Dataset", "metadata": {"name": name}, "spec": body | spec}
    )


def settings(**pods: Any) -> Settings:
    volumes = {"results": {"claim": "results"}, "data": {"claim": "data"}}
    return Settings.model_validate(
        {"namespaces": ["lab"], "image": "example.org/slamhive:1", "volumes": volumes, "pods": pods}
    )


def run(name: str = "study-abcdef", **metadata: Any) -> dict[str, Any]:
    body = {"name": name, "namespace": "lab", "uid": UID} | metadata
    return {"apiVersion": API, "kind": "MappingRun", "metadata": body, "spec": {}}


def spec_of(declared: Algorithm, data: Dataset, **spec: Any) -> dict[str, Any]:
    names = {"algorithmRef": {"name": declared.name}, "datasetRef": {"name": data.name}}
    return resolve(names | {"timeout": "30m", "input": {"frameRate": 5}} | spec, declared, data)


def built(
    body: dict[str, Any] | None = None,
    declared: Algorithm | None = None,
    companion: Companion | None = None,
    pods: dict[str, Any] | None = None,
    **spec: Any,
) -> dict[str, Any]:
    body, declared, data = body or run(), declared or algorithm(), dataset()
    resolved = spec_of(declared, data, **spec)
    return run_job(
        run=body,
        spec=resolved,
        algorithm=declared,
        configuration=configuration(body["metadata"]["name"], resolved, data, DESCRIPTION),
        description=DESCRIPTION,
        attempt=2,
        settings=settings(**(pods or {})),
        companion=companion or Companion(),
    )


def batch(count: int = 2) -> dict[str, Any]:
    runs = [
        {"uid": f"{UID[:-3]}{number:03}", "name": f"r{number}", "folder": f"runs/{UID[:-3]}{number:03}/{POD}"}
        for number in range(count)
    ]
    return {"evaluation": "ate", "settings": {"alignment": "Auto"}, "runs": runs}


def evaluating(request: dict[str, Any], evaluator: Evaluator | None = None) -> dict[str, Any]:
    owner = reference(Kind.EVALUATION, {"metadata": {"name": "ate", "uid": UID}})
    return evaluator_job(
        "lab",
        request,
        settings_hash=SHA,
        attempt=1,
        labels={"slamhive.io/evaluation": "ate"},
        owners=[owner],
        settings=settings(),
        evaluator=evaluator,
    )


def preparing(
    preparation: dict[str, Any] | None = None, by: str | None = None, **spec: Any
) -> dict[str, Any]:
    declared, data = algorithm(), dataset(**spec)
    return variant_job(
        namespace="lab",
        name="v-0123",
        dataset=data,
        algorithm=declared,
        spec=spec_of(declared, data, **({"input": {"preparedBy": by}} if by else {})),
        settings=settings().replace(preparation=PreparationJobs.model_validate(preparation or {})),
        owners=[reference(Kind.MAPPING_RUN, run())],
    )


def playing() -> dict[str, Any]:
    """The Job of a ROS 2 node, with its player."""
    poses = {"topic": "/odometry", "type": "Odometry"}
    node = {"recording": ["Rosbag2"], "paces": ["Stepped"], "ros2": {"poses": poses, "arguments": "Ros"}}
    declared, data, body = algorithm(**node), dataset(), run()
    resolved = spec_of(declared, data)
    recorded = DESCRIPTION | {"format": "Rosbag2", "recording": "recording"}
    told = configuration(body["metadata"]["name"], resolved, data, recorded)
    images = settings().replace(ros2_player_image="example.org/player:2")
    companion = player(
        run=body, algorithm=declared, configuration=told, description=recorded, settings=images
    )
    return run_job(
        run=body,
        spec=resolved,
        algorithm=declared,
        configuration=told,
        description=recorded,
        attempt=1,
        settings=images,
        companion=companion,
    )


TEMPLATE = "voxel: {{ parameters['voxel.size'] }}\ntopic: {{ sensors.lidar.topic|quoted }} # $(HOME)\n"
FILES = [{"path": "config/lio.yaml", "template": TEMPLATE}]


PROGRAMS = {
    "masked": {"image": "example.org/mask:1", "command": ["mask", "$(HOME)"], "disk": "5Gi"},
    "local": {"local": {"adapter": "mask.py"}},
}
MIRROR = {
    "catalogue": "sequences",
    "certificates": "mirror",
    "environment": {"https_proxy": "http://proxy:3128", "NOTE": "$(HOME)"},
}

JOBS = {
    "run": lambda: built(
        run(labels={"slamhive.io/sweep": "study", "slamhive.io/slot": "3", "kueue.x-k8s.io/queue-name": "q"}),
        pods=PODS,
        resources={"cpu": "1500m", "memory": "2Gi", "gpu": 1},
    ),
    "settings-files": lambda: built(declared=algorithm(files=FILES), resources={"cpu": 2, "memory": "2Gi"}),
    "ros2-node": playing,
    "prepare": preparing,
    "prepare-by-program": lambda: preparing(by="masked", preparations=PROGRAMS),
    "prepare-by-mirror": lambda: preparing(MIRROR),
    "evaluate": lambda: evaluating(batch()),
    "custom-evaluator": lambda: evaluating(
        batch(), Evaluator(image="example.org/eval:1", command=["measure", "$(HOME)"])
    ),
    "read": lambda: read_job(run=run(), pod_uid=POD, attempt=1, settings=settings()),
}


@pytest.mark.parametrize("name", JOBS)
def test_manifests_are_as_they_always_were(name: str) -> None:
    path = GOLDEN / f"{name}-job.yaml"
    made = JOBS[name]()
    if os.environ.get("SLAMHIVE_UPDATE"):
        path.write_text(yaml.safe_dump(made, sort_keys=False, width=110), encoding="utf-8")
    assert made == yaml.safe_load(path.read_text(encoding="utf-8"))


def containers(job: dict[str, Any]) -> list[dict[str, Any]]:
    pod = job["spec"]["template"]["spec"]
    return [*pod.get("initContainers", []), *pod["containers"]]


@pytest.mark.parametrize("name", JOBS)
def test_every_pod_keeps_to_restricted_pod_security(name: str) -> None:
    job = JOBS[name]()
    pod = job["spec"]["template"]["spec"]
    assert pod["securityContext"]["runAsNonRoot"]
    assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert pod["automountServiceAccountToken"] is False
    volumes = {kind for volume in pod["volumes"] for kind in volume if kind != "name"}
    own = {"configMap"} if name == "prepare-by-mirror" else set()
    assert volumes <= {"downwardAPI", "emptyDir", "persistentVolumeClaim"} | own
    for container in containers(job):
        context = container["securityContext"]
        assert context["capabilities"] == {"drop": ["ALL"]}
        assert (context["allowPrivilegeEscalation"], context["readOnlyRootFilesystem"]) == (False, True)
        resources = container["resources"]
        for what in ("cpu", "memory"):
            assert resources["requests"][what] == resources["limits"][what]


@pytest.mark.parametrize("name", JOBS)
def test_every_pod_ends_and_is_repeated_for_disruptions_alone(name: str) -> None:
    spec = JOBS[name]()["spec"]
    rules = spec["podFailurePolicy"]["rules"]
    assert (spec["backoffLimit"], spec["podReplacementPolicy"]) == (0, "Failed")
    assert [rule["action"] for rule in rules] == ["Ignore"]
    assert spec["template"]["spec"]["activeDeadlineSeconds"] > 0
    assert "activeDeadlineSeconds" not in spec  # it would delete the pod with its last words


def test_ground_truth_is_out_of_a_run_pods_reach() -> None:
    job = built()
    mounts = [mount for container in containers(job) for mount in container["volumeMounts"]]
    data = [mount for mount in mounts if mount["name"] == "data"]
    assert {mount["subPath"] for mount in data} == {"variants/0123abcd", f"assets/{'c' * 64}"}
    assert all(mount["readOnly"] for mount in data)
    results = [mount["subPathExpr"] for mount in mounts if mount["name"] == "results"]
    assert results == [f"runs/{UID}/$(POD_UID)", f"runs/{UID}/$(POD_UID)/output"]


def test_what_users_write_is_never_expanded() -> None:
    job = built(companion=Companion(variables={"TEXT": "$(POD_UID)"}))
    main = containers(job)[1]
    assert main["command"] == ["lio", "--config", "$$(HOME)/x y; rm -rf $$HOME"]
    assert {"name": "TEXT", "value": "$$(POD_UID)"} in main["env"]


def test_a_run_is_told_what_it_may_use() -> None:
    job = built(resources={"cpu": "1500m", "memory": "2Gi", "gpu": 2})
    monitor, main = containers(job)
    env = {item["name"]: item.get("value") for item in main["env"]}
    assert (env["OMP_NUM_THREADS"], env["SLAMHIVE_SEED"]) == ("2", "1")
    assert main["resources"]["limits"]["nvidia.com/gpu"] == "2"
    told = json.loads(next(item["value"] for item in monitor["env"] if item["name"] == "SLAMHIVE_SIDECAR"))
    assert (told["timeoutSeconds"], told["memoryLimitBytes"], told["dataSeconds"]) == (1800, 2**31, 26)
    text = job["spec"]["template"]["metadata"]["annotations"]["slamhive.io/configuration"]
    view = yaml.safe_load(text)
    assert (view["run"], view["cores"], view["parameters"]) == ("study-abcdef", 2, {"voxel.size": 0.5})
    assert view["dataset"]["gravityAligned"]
    assert view["dataset"]["recording"] == {"format": "Rosbag1", "path": "dataset/recording.bag"}
    assert view["input"]["frameRate"] == 5


def test_a_generated_world_is_level_whether_its_dataset_says_so_or_not() -> None:
    synthetic = {"synthetic": {"seed": 1, "sensors": ["Lidar"], "durationSeconds": 30}}
    data = dataset(recording=synthetic, sensors={}, gravityAligned=False)
    view = configuration("r", spec_of(algorithm(), data), data, DESCRIPTION)
    assert view.dataset.gravity_aligned


@pytest.mark.parametrize("name", JOBS)
def test_every_pod_gets_the_runtime_class(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them run images or read data that others brought."""
    made = settings
    monkeypatch.setitem(globals(), "settings", lambda **pods: made(**pods | {"runtimeClassName": "gvisor"}))
    assert JOBS[name]()["spec"]["template"]["spec"]["runtimeClassName"] == "gvisor"


def test_a_run_with_its_node_for_itself_is_kept_from_all_other_runs_whatever_pods_are_given() -> None:
    def apart(**pods: Any) -> dict[str, Any]:
        resources = {"exclusiveNodes": True}
        return built(pods=pods, resources=resources)["spec"]["template"]["spec"]["affinity"]

    rule = "requiredDuringSchedulingIgnoredDuringExecution"
    [term] = apart()["podAntiAffinity"][rule]
    labels = built()["spec"]["template"]["metadata"]["labels"]
    assert term["labelSelector"]["matchLabels"].items() <= labels.items()
    assert (term["namespaceSelector"], term["topologyKey"]) == ({}, "kubernetes.io/hostname")
    node, other = {"nodeAffinity": {rule: {}}}, {"topologyKey": "zone"}
    given = node | {"podAntiAffinity": {rule: [other]}}
    assert apart(affinity=given) == node | {"podAntiAffinity": {rule: [other, term]}}
    for pods, left in (({}, None), ({"affinity": node}, node), ({"affinity": given}, given)):
        like = built(pods=pods, resources={"exclusiveNodes": True})["spec"]["template"]["spec"]
        # Who fetches its files is no run, and waits for none.
        assert sender_job("lab", "s", like)["spec"]["template"]["spec"].get("affinity") == left
    assert "affinity" not in built(resources={"exclusiveNodes": False})["spec"]["template"]["spec"]


def test_queues_labels_are_handed_on_and_no_others() -> None:
    labels = {
        "app": "payments",
        "azure.workload.identity/use": "true",
        "kueue.x-k8s.io/queue-name": "q",
        "slamhive.io/role": "prepare",
        "slamhive.io/slot": "1",
        "app.kubernetes.io/managed-by": "Helm",
        "argocd.argoproj.io/instance": "x",
        "job-name": "x",
    }
    annotations = {
        "kubectl.kubernetes.io/last-applied-configuration": "{}",
        "slamhive.io/configuration": "mine",
        "container.apparmor.security.beta.kubernetes.io/algorithm": "unconfined",
        "kueue.x-k8s.io/job-uid": "a",
        "k8s.v1.cni.cncf.io/networks": "host-net",
        "vault.hashicorp.com/agent-inject": "true",
    }
    job = built(run(labels=labels, annotations=annotations))
    for metadata in (job["metadata"], job["spec"]["template"]["metadata"]):
        assert metadata["labels"]["kueue.x-k8s.io/queue-name"] == "q"
        assert metadata["labels"]["slamhive.io/role"] == "run"
        assert metadata["labels"]["slamhive.io/slot"] == "1"
        assert metadata["labels"]["app.kubernetes.io/managed-by"] == "slamhive"
        others = {"argocd.argoproj.io/instance", "job-name", "app", "azure.workload.identity/use"}
        assert not others & metadata["labels"].keys()
    assert job["metadata"]["annotations"] == {"kueue.x-k8s.io/job-uid": "a"}
    made = job["spec"]["template"]["metadata"]["annotations"]
    assert made.keys() == {"kueue.x-k8s.io/job-uid", "slamhive.io/configuration"}
    assert made["slamhive.io/configuration"] != "mine"


def test_settings_files_are_rendered_before_all_others_and_the_algorithm_can_not_change_them() -> None:
    job = built(declared=algorithm(files=FILES))
    pod = job["spec"]["template"]["spec"]
    render, monitor = pod["initContainers"]
    assert (render["name"], render["image"], monitor["name"]) == (
        "render",
        "example.org/slamhive:1",
        "monitor",
    )
    # One that is to end, where the monitor stays.
    assert "restartPolicy" not in render
    mounts = {mount["mountPath"]: mount for mount in containers(job)[-1]["volumeMounts"]}
    assert mounts["/slamhive/files"]["readOnly"]
    assert mounts["/slamhive/files"]["subPathExpr"] == f"runs/{UID}/$(POD_UID)/files"
    env = {item["name"]: item.get("value") for item in containers(job)[-1]["env"]}
    assert env["SLAMHIVE_FILES"] == "/slamhive/files"
    asked = json.loads(job["spec"]["template"]["metadata"]["annotations"]["slamhive.io/render"])
    assert asked == {"files": FILES, "run": "/slamhive"}


def test_an_algorithm_without_settings_files_is_run_as_before() -> None:
    for declared in (algorithm(), algorithm(files=[])):
        assert built(declared=declared) == built()


def test_templates_beside_a_large_configuration_are_refused_before_the_api_server_does() -> None:
    texts = {f"p{k}": {"type": "String", "default": "\u00e9" * (TEXT_LIMIT - 100)} for k in range(3)}
    files = [{"path": f"{k}", "template": "\x01" * 10_000} for k in range(6)]
    with pytest.raises(InputError, match=r"bytes.*(fit|holds)"):
        built(declared=algorithm(parameters=texts, files=files))


def test_a_player_is_added_beside_the_algorithm() -> None:
    player = {"name": "player", "image": "example.org/ros:1"}
    volume, mount = {"name": "ros", "emptyDir": {}}, {"name": "ros", "mountPath": "/slamhive/ros"}
    job = built(companion=Companion((player,), (), (volume,), (mount,), {"ROS_MASTER_URI": "http://x"}))
    pod = job["spec"]["template"]["spec"]
    assert [container["name"] for container in pod["containers"]] == ["algorithm", "player"]
    assert volume in pod["volumes"]
    assert mount in pod["containers"][0]["volumeMounts"]


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"image": None, "local": {}}, "has no image"),
        (
            {"parameters": {f"p{k}": {"type": "String", "default": "\x7f" * TEXT_LIMIT} for k in range(7)}},
            "the configuration has",
        ),
    ],
)
def test_what_no_pod_can_be_made_of_is_refused(change: dict[str, Any], part: str) -> None:
    with pytest.raises(InputError, match=part):
        built(declared=algorithm(**change))


def test_handed_on_annotations_are_to_leave_room_for_ours() -> None:
    with pytest.raises(InputError, match="the annotations have"):
        built(run(annotations={"kueue.x-k8s.io/note": "x" * 256 * 1024}))


def test_what_is_handed_on_is_a_setting() -> None:
    labels = {"example.org/team": "a", "example.org/teams": "b", "queue/x": "c", "queues/x": "d"}
    allowed = settings().replace(passed_labels=["example.org/team", "queue/"])
    assert passed_on(labels, allowed) == {"example.org/team": "a", "queue/x": "c"}


@pytest.mark.parametrize("bad", ["../x", "a/b", "..", "", ".", "a b", "$(HOME)"])
def test_no_identity_leads_out_of_its_folder(bad: str) -> None:
    with pytest.raises(InputError, match="cannot be part of a path"):
        built(run(uid=bad))
    with pytest.raises(InputError, match="cannot be part of a path"):
        read_job(run=run(), pod_uid=bad, attempt=1, settings=settings())
    with pytest.raises(InputError, match="cannot be part of a path"):
        evaluating({"settings": {}, "runs": [{"uid": bad}]})
    with pytest.raises(ValueError, match="folder"):
        configuration("r", spec_of(algorithm(), dataset()), dataset(), DESCRIPTION | {"folder": bad})


@pytest.mark.parametrize("bad", ["..", "../x", "a/../b", "A", "a/b", ""])
def test_no_name_of_a_dataset_or_algorithm_is_a_path(bad: str) -> None:
    with pytest.raises(ValueError, match="name"):
        dataset(bad)


@pytest.mark.parametrize(
    ("name", "attempt", "expected"),
    [
        ("study-abc", 1, "study-abc-1"),
        ("a" * 61, 2, "a" * 61 + "-2"),
        ("a" * 62, 2, "a" * 50 + "-8823dd1063-2"),
        ("v1.2", 3, None),
    ],
)
def test_names_of_jobs_are_dns_labels(name: str, attempt: int, expected: str | None) -> None:
    made = job_name(name, attempt)
    assert len(made) <= 63
    assert "." not in made
    assert made.endswith(f"-{attempt}")
    assert expected is None or made == expected
    assert job_name("a.b", 1) != job_name("a-b", 1)


@pytest.mark.parametrize("text", ["hall", "", "a" * 63, "a" * 64, "ä b", "-x-", "x" * 300, "a."])
def test_labels_hold_whatever_text(text: str) -> None:
    value = label_value(text)
    assert len(value) <= 63
    assert value == text or value[-10:].isalnum()
    assert label_value(text + "x" * 64) != label_value(text + "y" * 64)


def named(data: Dataset | None = None, mode: SensorMode = SensorMode.LIDAR, **options: Any) -> str:
    declared = algorithm()
    wish = InputOptions.model_validate(options)
    roles = declared.spec.mode(mode).needs
    return variant_name(data or dataset(), roles, wish, declared.spec.recording, declared.spec.assets)


def test_equal_wishes_share_a_variant() -> None:
    assert named() == named(pace="Lockstep", rate=2.0) == named(resolution=1.0)
    assert named() == named(dataset(description="Another sentence", attributes={"loops": 2}))
    others = [named(frameRate=5), named(start="1s"), named(remap={"lidar": "x"}), named(lidar={"rings": 8})]
    others += [named(dataset("yard")), named(dataset(recording={"files": [{"path": "hall/b.bag"}]}))]
    assert len({named(), *others}) == 7
    assert len(named()) == 22


def test_a_perturbation_that_changes_something_has_a_variant_of_its_own() -> None:
    nothing = {"seed": 3, "lidar": {"rangeNoise": 0}, "images": {"gamma": 1}}
    assert named() == named(perturb=nothing) == named(perturb={})
    noise: dict[str, Any] = {"lidar": {"rangeNoise": 0.1}}
    others = [named(perturb=one) for one in (noise, noise | {"seed": 3}, {"timeOffset": {"lidar": 0.1}})]
    assert len({named(), *others}) == 4
    assert named(perturb=noise | {"seed": 1}) == others[0]


def test_programs_that_a_dataset_names_change_variants_of_those_that_ask_for_them() -> None:
    def by(name: str, **changes: Any) -> str:
        programs = PROGRAMS | {"masked": PROGRAMS["masked"] | changes}
        return named(dataset(preparations=programs), preparedBy=name)

    assert named() == named(dataset(preparations=PROGRAMS)) == by("none")
    same = [by("masked"), by("masked", description="Another", memory="1Gi")]
    others = [by("masked", image="example.org/mask:2"), by("masked", command=["other"])]
    assert (len({*same}), len({named(), *same, *others})) == (1, 4)


def test_a_program_of_a_dataset_sees_its_frames_and_nothing_else() -> None:
    show, program, prepare = containers(preparing(by="masked", preparations=PROGRAMS))
    places = {place["mountPath"]: place.get("readOnly", False) for place in program["volumeMounts"]}
    assert places == {"/slamhive/in": True, "/slamhive/own": False, "/tmp": False}
    assert (show["image"], program["image"]) == (prepare["image"], "example.org/mask:1")
    assert all(place["name"] in {"in", "own"} for place in program["volumeMounts"])
    with pytest.raises(InputError, match="names no image"):
        preparing(by="local", preparations=PROGRAMS)


def test_a_preparation_is_asked_for_what_matters() -> None:
    job = preparing()
    text = job["spec"]["template"]["metadata"]["annotations"]["slamhive.io/request"]
    request = json.loads(text)
    assert request["input"] == {"frameRate": 5, "resolution": 1.0, "remap": {}}
    assert Dataset.model_validate(request["dataset"]).spec == dataset().spec
    assert [asset["name"] for asset in request["assets"]] == ["weights/net.bin"]
    assert job["metadata"]["name"] == "prepare-v-0123"
    with pytest.raises(InputError, match="the request has"):
        preparing(description="x" * ANNOTATION_LIMIT)


def test_batches_fit_into_objects() -> None:
    small = batch(450)["runs"]
    assert [len(part) for part in batches(small, 200)] == [200, 200, 50]
    large = [found | {"name": "ä" * 10_000} for found in batch(20)["runs"]]
    parts = list(batches(large, 200))
    assert list(chain.from_iterable(parts)) == large
    assert len(parts) == 3
    for part in parts:
        evaluating(batch() | {"runs": part})


def test_the_same_batch_has_the_same_job() -> None:
    request = batch(3)
    turned = request | {"runs": request["runs"][::-1]}
    assert evaluator_job_name("lab", request, SHA, 1) == evaluator_job_name("lab", turned, SHA, 1)
    others = {evaluator_job_name("lab", request, SHA, 2), evaluator_job_name("x", request, SHA, 1)}
    assert evaluator_job_name("lab", request, SHA, 1) not in others


def test_a_custom_evaluator_writes_nothing_but_its_output() -> None:
    job = evaluating(batch(), Evaluator(image="example.org/eval:1"))
    links, theirs, report = containers(job)
    writable = [place["mountPath"] for place in theirs["volumeMounts"] if not place.get("readOnly")]
    assert writable == ["/slamhive/output", "/tmp"]
    assert [body["name"] for body in (links, theirs, report)] == ["links", "evaluator", "report"]
    assert theirs["image"] == "example.org/eval:1"
    assert "command" not in theirs


def told_to_the_monitor(**output: Any) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the order of a run's monitor, and its mounts."""
    declared = algorithm(output={"frame": "lidar"} | output)
    monitor = built(declared=declared)["spec"]["template"]["spec"]["initContainers"][0]
    variables = {one["name"]: one.get("value") for one in monitor["env"]}
    return json.loads(variables["SLAMHIVE_SIDECAR"]), monitor["volumeMounts"]


def test_the_monitor_is_told_where_the_program_writes_its_poses() -> None:
    told, mounts = told_to_the_monitor(trajectory={"path": "Tcw.txt", "format": "Tum", "inverted": True})
    file = {"path": "Tcw.txt", "format": "Tum", "stamps": "s", "inverted": True}
    assert told["poses"] == {"trajectory": file}
    assert SidecarSpec.from_json(json.dumps(told)).poses == told["poses"]
    assert {mount["name"] for mount in mounts} == {"results", "configuration"}


def test_the_monitor_sees_the_stamps_of_frames_where_poses_count_them() -> None:
    told, mounts = told_to_the_monitor(keyframes={"path": "keys.txt", "format": "Kitti"})
    (frames,) = [mount for mount in mounts if mount["name"] == "data"]
    assert (frames["subPath"], frames["readOnly"]) == ("variants/0123abcd/frames.txt", True)
    assert told["poses"]["frames"] == frames["mountPath"]
    assert SidecarSpec.from_json(json.dumps(told)).poses == told["poses"]


def test_a_mode_is_prepared_in_the_forms_that_hold_it() -> None:
    both = algorithm(recording=["Euroc", "Kitti"], modes=[{"name": "lidar"}, {"name": "mono"}])
    camera = {
        "type": "Camera",
        "topic": "/cam",
        "camera": {"width": 4, "height": 3, "fx": 4, "fy": 4, "cx": 2, "cy": 1},
    }
    data = dataset(sensors={"lidar": SENSOR, "camera": camera})
    asked = {
        mode: variant_request(data, both, spec_of(both, data, sensors=mode)) for mode in ("lidar", "mono")
    }
    assert [str(form) for form in asked["lidar"].formats] == ["Kitti"]
    assert [str(form) for form in asked["mono"].formats] == ["Euroc", "Kitti"]


def test_a_pod_is_told_where_in_a_folder_things_are() -> None:
    described = DESCRIPTION | {"format": "Kitti", "recording": "recording"}
    declared, data = algorithm(recording=["Kitti"]), dataset()
    told = configuration("r", spec_of(declared, data), data, described).as_json()
    assert told["dataset"]["recording"] == {
        "format": "Kitti",
        "path": "dataset/recording",
        "files": {"lidar": "velodyne", "times": "times.txt", "calibration": "calib.txt"},
    }


def test_runs_with_nodes_for_themselves_are_no_more_than_nodes() -> None:
    nodes = [
        {
            "metadata": {"name": name},
            "status": {"allocatable": {"cpu": "16", "memory": "64Gi", "pods": "110"}},
        }
        for name in ("n1", "n2")
    ]
    resources = {"cpu": "1", "memory": "4Gi"}
    counts = [
        bound_by_nodes(nodes, least_requests(resources | more, settings()), {}).runs
        for more in ({}, {"exclusiveNodes": True})
    ]
    assert counts == [26, 2]
