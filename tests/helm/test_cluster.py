# SPDX-License-Identifier: Apache-2.0
"""The charts on a real API server: installed, upgraded, tested, taken away; what accounts may do there."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from testcluster.access import until
from testcluster.errors import ClusterError

from slamhive.kube.api.kinds import OUR_KINDS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from testcluster.access import Cluster

CHARTS = Path(__file__).parents[2] / "helm"
KINDS = sorted(f"{kind.plural}.slamhive.io" for kind in OUR_KINDS)
KEPT = {"persistentvolumeclaims", "algorithms.slamhive.io", "datasets.slamhive.io"}
MADE = [
    *("deployments", "cronjobs", "services", "configmaps", "serviceaccounts", "roles", "rolebindings"),
    *("networkpolicies", "persistentvolumeclaims", "algorithms.slamhive.io", "datasets.slamhive.io"),
]
IMAGE = "docker.io/slamhive/slamhive:0.1.0"

pytestmark = [pytest.mark.cluster]
Install = Any


@pytest.fixture(scope="session")
def kinds(helm: Any, control_plane: Cluster) -> Cluster:
    """The cluster with our kinds, by their chart."""
    words = ("upgrade", "--install", "slamhive-crds", str(CHARTS / "slamhive-crds"), "--take-ownership")
    run(helm, control_plane, *words, "-n", "kube-system", "--set", "aggregateRoles=true")
    control_plane.await_kinds(KINDS)
    return control_plane


def run(helm: Any, cluster: Cluster, *words: str, code: int = 0) -> str:
    done = subprocess.run(
        [helm.program, *words], env=cluster.environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture
def install(helm: Any, kinds: Cluster, tmp_path: Path) -> Iterator[Install]:
    """Install or upgrade the chart in a namespace; what it leaves outside of it goes at the end."""
    volumes: set[str] = set()

    def call(namespace: str, *words: str, release: str = "slamhive", code: int = 0, **values: Any) -> str:
        file = tmp_path / f"{namespace}.yaml"
        file.write_text(yaml.safe_dump(values))
        volumes.update(f"{namespace}-slamhive-{name}" for name in ("results", "data", "archive"))
        chart = str(CHARTS / "slamhive")
        return run(
            helm,
            kinds,
            "upgrade",
            "--install",
            release,
            chart,
            "-n",
            namespace,
            "-f",
            str(file),
            *words,
            code=code,
        )

    yield call
    kinds.run("delete", "persistentvolume", *volumes, "--ignore-not-found", "--wait=false")


def left(cluster: Cluster, namespace: str) -> set[str]:
    """Kinds of objects of the release that are there."""
    label = "app.kubernetes.io/part-of=slamhive"
    return {kind for kind in MADE if cluster.get(kind, "-n", namespace, "-l", label)["items"]}


def test_kinds_are_upgraded_and_kept(helm: Any, kinds: Cluster) -> None:
    chart, where = str(CHARTS / "slamhive-crds"), ("-n", "kube-system")
    run(helm, kinds, "upgrade", "slamhive-crds", chart, *where, "--set", "labels.upgraded=really")
    assert all(kinds.get("crd", kind)["metadata"]["labels"]["upgraded"] == "really" for kind in KINDS)
    told = run(helm, kinds, "uninstall", "slamhive-crds", *where)
    assert all(kind in told for kind in KINDS)
    assert all(kinds.get("crd", kind)["metadata"].get("deletionTimestamp") is None for kind in KINDS)
    run(helm, kinds, "install", "slamhive-crds", chart, *where)


def test_install_upgrade_uninstall_and_again(
    helm: Any, kinds: Cluster, namespace: str, install: Install, tmp_path: Path
) -> None:
    local = {name: {"local": {"path": str(tmp_path / name)}} for name in ("results", "data")}
    install(namespace, volumes=local, catalog={"enabled": True, "algorithms": ["kiss-icp"]})
    assert left(kinds, namespace) == {*MADE}
    before = kinds.get("algorithm", "kiss-icp", "-n", namespace)

    # Another registry would be another spec, which may not change: the Algorithm stays as it is.
    registry = {"enabled": True, "algorithms": ["kiss-icp"], "imageRegistry": "registry.example.org"}
    install(namespace, volumes=local, catalog=registry, settings={"workers": 3})
    after = kinds.get("algorithm", "kiss-icp", "-n", namespace)
    assert after["spec"] == before["spec"]
    settings = kinds.get("configmap", "slamhive-settings", "-n", namespace)["data"]["operator.yaml"]
    assert yaml.safe_load(settings)["workers"] == 3

    run(helm, kinds, "uninstall", "slamhive", "-n", namespace)
    until(lambda: left(kinds, namespace) == KEPT, "all but claims and catalog to go")
    install(namespace, volumes=local, catalog=registry)
    assert left(kinds, namespace) == {*MADE}


def test_one_release_a_namespace(kinds: Cluster, namespace: str, install: Install) -> None:
    install(namespace)
    told = install(namespace, release="second-slamhive", code=1)
    assert f"namespace {namespace}: the release slamhive has an operator here already" in told


def test_pods_are_admitted_under_the_restricted_standard(
    kinds: Cluster, make_namespace: Callable[[str], str], install: Install
) -> None:
    """The API server's own admission agrees with the tests' reading of the standard."""
    home, workspace = make_namespace("-home"), make_namespace("-work")
    secret = {"apiVersion": "v1", "kind": "Secret", "metadata": {"name": "database"}}
    for name in (home, workspace):
        kinds.apply(secret | {"stringData": {"url": "postgresql://nobody@127.0.0.1/none"}}, namespace=name)
    install(home, workspaces=[workspace], archive={"existingSecret": "database"})
    for name in (home, workspace):
        kinds.kubectl("create", "job", "collect", "--from=cronjob/slamhive-collector", "-n", name)

    def admitted() -> bool:
        pods = kinds.get("pods", "-n", home)["items"] + kinds.get("pods", "-n", workspace)["items"]
        components = [pod["metadata"]["labels"]["app.kubernetes.io/component"] for pod in pods]
        return sorted(components) == ["collector", "collector", "dashboard", "operator"]

    # Controllers that a restart of the API server left waiting take a while to come back.
    until(admitted, "pods of operator, dashboard and both collectors", 240)


READ = ("get", "list", "watch")
CAN = {
    "operator": {
        **dict.fromkeys(KINDS, READ),
        "mappingruns.slamhive.io": (*READ, "create", "patch", "delete"),
        **{kind.replace(".", "/status.", 1): ("patch",) for kind in KINDS},
        "jobs.batch": (*READ, "create", "patch", "delete"),
        "pods": READ,
        "pods/log": ("get",),
        "pods.metrics.k8s.io": ("get", "list"),
        "resourcequotas": ("list",),
        "events": ("get", "list", "create", "patch"),
    },
    "runs": {},
    "collector": {
        **{f"{kind}.slamhive.io": ("get", "list") for kind in ("algorithms", "datasets", "mappingruns")},
        "namespaces {tenant}": ("get",),
        "cronjobs.batch slamhive-collector": ("get",),
        "events": ("create",),
    },
    "dashboard": dict.fromkeys(KINDS, READ),
}
"""Everything that an account may do in its namespace, of one object where named; elsewhere nothing."""


@pytest.fixture(scope="module")
def tenant(helm: Any, kinds: Cluster) -> Iterator[str]:
    """A namespace with the chart in it, for all questions about rights."""
    name = f"t-helm-rights-{os.getpid()}"
    kinds.apply({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
    chart = str(CHARTS / "slamhive")
    run(helm, kinds, "install", "slamhive", chart, "-n", name)
    yield name
    kinds.kubectl("delete", "namespace", name, "--wait=false")


@pytest.mark.parametrize("account", CAN)
def test_accounts_may_do_what_they_need_and_nothing_else(kinds: Cluster, tenant: str, account: str) -> None:
    expected = {
        (verb, resource.format(tenant=tenant)) for resource, verbs in CAN[account].items() for verb in verbs
    }
    assert may(kinds, tenant, account, tenant) == expected
    assert may(kinds, tenant, account, "default") == set()


def may(cluster: Cluster, tenant: str, account: str, namespace: str) -> set[tuple[str, str]]:
    """Return the rights of a namespace's account in a namespace, as the API server says them."""
    review = {
        "apiVersion": "authorization.k8s.io/v1",
        "kind": "SelfSubjectRulesReview",
        "spec": {"namespace": namespace},
    }
    user = f"--as=system:serviceaccount:{tenant}:slamhive-{account}"
    answer = cluster.kubectl(
        "create", user, "--validate=false", "-o", "json", "-f", "-", stdin=yaml.safe_dump(review)
    )
    status = yaml.safe_load(answer)["status"]
    assert not status["incomplete"]
    return {
        (verb, " ".join((f"{resource}.{group}".rstrip("."), *rule.get("resourceNames", ()))))
        for rule in status["resourceRules"]
        for resource in rule["resources"]
        for group in rule["apiGroups"]
        for verb in rule["verbs"]
        if not resource.startswith("selfsubject")
    }


JOBS = Path(__file__).parents[1] / "kube" / "golden"
ODD = {
    "the account slamhive-runs": [{"serviceAccountName": "slamhive-operator"}, {"serviceAccountName": None}],
    "and no token": [{"automountServiceAccountToken": True}],
    "mount the release's volumes": [
        {"volumes": [{"name": "x", "secret": {"secretName": "another"}}]},
        {"volumes": [{"name": "x", "projected": {"sources": [{"serviceAccountToken": {"path": "token"}}]}}]},
        {"volumes": [{"name": "x", "persistentVolumeClaim": {"claimName": "of-others"}}]},
        {"volumes": [{"name": "x", "configMap": {"name": "of-others"}}]},
    ],
    "hold values and fields": [
        {"env": [{"name": "X", "valueFrom": {"secretKeyRef": {"name": "another", "key": "x"}}}]},
        {"envFrom": [{"secretRef": {"name": "another"}}]},
    ],
    "by imagePullSecrets": [{"imagePullSecrets": [{"name": "another"}]}],
}
"""Changes of a pod or its container, by the words with which they are refused."""


def test_the_job_policy_leaves_the_operator_its_own_jobs(
    helm: Any, kinds: Cluster, namespace: str, install: Install
) -> None:
    maps = {"catalogue": "sequences", "certificates": "mirror"}
    install(namespace, jobPolicy=True, imagePullSecrets=["registry"], settings={"preparation": maps})
    try:
        own = [yaml.safe_load(path.read_text()) for path in sorted(JOBS.glob("*-job.yaml"))]
        usual = own[0]
        until(
            lambda: "and no token" in answer(kinds, namespace, usual, ODD["and no token"][0]),
            "the policy to be in force",
        )
        for job in own:
            assert not answer(kinds, namespace, job, {}), job["metadata"]["name"]
        for told, changes in ODD.items():
            for change in changes:
                assert told in answer(kinds, namespace, usual, change), change
        assert not answer(kinds, namespace, usual, ODD["and no token"][0], account=None)
    finally:
        run(helm, kinds, "uninstall", "slamhive", "-n", namespace)


def answer(
    cluster: Cluster, namespace: str, job: Any, change: Any, account: str | None = "slamhive-operator"
) -> str:
    """Return the API server's refusal of a changed Job that an account would make; empty for none."""
    body = yaml.safe_load(yaml.safe_dump(job).replace("claimName: ", "claimName: slamhive-"))
    pod = body["spec"]["template"]["spec"]
    pod["serviceAccountName"] = "slamhive-runs"
    (pod["containers"][0] if {*change} & {"env", "envFrom"} else pod).update(change)
    for container in (*pod["containers"], *pod.get("initContainers", ())) if "volumes" in change else ():
        container["volumeMounts"] = []
    body["metadata"] |= {"namespace": namespace}
    user = [f"--as=system:serviceaccount:{namespace}:{account}"] if account else []
    words = ("create", "--dry-run=server", "--validate=false", "-f", "-", *user)
    done = cluster.run(*words, stdin=yaml.safe_dump(body))
    return done.stderr if done.returncode else ""


@pytest.mark.slow
def test_helm_test_on_a_node(  # noqa: PLR0917 - fixtures
    helm: Any, node_cluster: Cluster, kinds: Cluster, namespace: str, install: Install, tmp_path: Path
) -> None:
    """Everything at work: volumes of the node, the operator ready, its metrics, the collector."""
    try:
        node_cluster.load(IMAGE)
    except ClusterError as error:
        pytest.skip(f"no image {IMAGE}, make images builds it: {error}")
    values = {"volumes": {}, "archive": {"sqlite": {"enabled": True}}}
    for name in ("results", "data", "archive"):
        (tmp_path / name).mkdir()
        values["volumes"][name] = {"local": {"path": str(tmp_path / name)}}
    install(namespace, "--wait", "--timeout", "180s", **values)
    told = run(helm, kinds, "test", "slamhive", "-n", namespace)
    assert "Phase:          Succeeded" in told
    assert "ok    kinds: all served" in told
    assert "ok    /slamhive/data: writable by user 65532" in told
    service = kinds.get("service", "slamhive-metrics", "-n", namespace)["metadata"]["name"]
    proxied = f"/api/v1/namespaces/{namespace}/services/{service}:metrics/proxy/metrics"
    assert "slamhive_queue_depth" in kinds.kubectl("get", "--raw", proxied)

    kinds.kubectl("create", "job", "collect", "--from=cronjob/slamhive-collector", "-n", namespace)
    kinds.kubectl("wait", "job/collect", "--for=condition=Complete", "--timeout=240s", "-n", namespace)
    run(helm, kinds, "uninstall", "slamhive", "-n", namespace, "--wait")
    until(
        lambda: (
            kinds.get("pods", "-n", namespace, "-l", "app.kubernetes.io/component=operator")["items"] == []
        ),
        "the operator to go",
    )
