# SPDX-License-Identifier: Apache-2.0
"""Algorithms that nobody here wrote an adapter for: one that keeps the contract, many that break it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from onnode.documents import ROOT
from onnode.lab import manifest
from onnode.node import Watch
from testcluster.access import until

if TYPE_CHECKING:
    from onnode.lab import Lab

IMAGES = ROOT / "tests" / "images"
FAILED, SUCCEEDED = "Failed", "Succeeded"
ENDS = {
    "crash": (FAILED, "AlgorithmFailed", "exit code 3: the voxel map is empty"),
    "segfault": (FAILED, "AlgorithmFailed", "SIGSEGV"),
    "hang": (FAILED, "DeadlineExceeded", "20 s"),
    "deaf": (FAILED, "DeadlineExceeded", "20 s"),
    "memory": (FAILED, "OutOfMemory", "it needed more memory than its limit"),
    "forks": (FAILED, "DeadlineExceeded", "20 s"),
    "orphans": (SUCCEEDED, None, ""),
    "log": (FAILED, "DeadlineExceeded", "20 s"),
    "outside": (FAILED, "AlgorithmFailed", "exit code 5: nothing outside of the output can be written"),
    "not-a-number": (FAILED, "InvalidTrajectory", "line 51: tx is nan"),
    "garbage": (FAILED, "InvalidTrajectory", "output/trajectory.txt"),
    "endless-line": (FAILED, "InvalidTrajectory", "line 1: is longer than 64 KiB"),
    "vast-trajectory": (FAILED, "InvalidTrajectory", "is larger than 512 MiB"),
    "link": (FAILED, "NoTrajectory", "is missing or not a regular file"),
    "fifo": (FAILED, "NoTrajectory", "is missing or not a regular file"),
    "folder": (FAILED, "NoTrajectory", "is missing or not a regular file"),
    "no-trajectory": (FAILED, "NoTrajectory", "is missing or not a regular file"),
    "nothing": (FAILED, "NoTrajectory", "is missing or not a regular file"),
    "lost": (SUCCEEDED, None, ""),
    "flood": (SUCCEEDED, None, ""),
}
"""Phase, reason and a part of the message for each way to misbehave."""
LASTING = ("hang", "deaf", "forks", "memory", "log", "flood")
"""What ends within milliseconds may leave no figures."""


def test_an_algorithm_in_shell_alone_gets_a_result(lab: Lab) -> None:
    lab.apply_algorithm(IMAGES / "shell-algorithm")
    lab.apply(lab.run("in-shell", "shell-dead-reckoning"))
    status = lab.evaluated("in-shell")
    assert status["phase"] == SUCCEEDED
    assert status["frames"] == {"offered": 120, "processed": 120, "dropped": 0}
    (result,) = status["results"]
    assert result["ate"]["rmse"] > 0.1
    assert result["poses"] == 120
    folder = lab.results / status["folder"]
    assert len((folder / "output" / "trajectory.txt").read_text().splitlines()) == 120
    assert {path.name for path in folder.iterdir()} >= {"summary.json", "usage.csv"}


@pytest.fixture(scope="module")
def misbehaved(lab: Lab) -> dict[str, dict[str, Any]]:
    """How each mode ended, in one sweep with runs of a well-behaved algorithm beside it."""
    lab.apply_algorithm(IMAGES / "shell-algorithm")
    lab.apply_algorithm(IMAGES / "misbehaving")
    template = lab.run("x", "misbehaving", timeout="20s", retries=0)["spec"]
    template["resources"] = {"cpu": "100m", "memory": "128Mi"}
    sweep = manifest(
        "Sweep",
        "misbehaving",
        template={"spec": template},
        matrix=[{"path": "parameters.mode", "values": [*ENDS]}],
        # Writing gigabytes takes its time, as writing that much of log does, which is cut off.
        include=[{"parameters.mode": "flood", "timeout": "10m", "resources.cpu": "500m"}],
        parallelism=5,
    )
    beside = manifest(
        "Sweep",
        "beside",
        template={"spec": lab.run("x", "shell-dead-reckoning")["spec"]},
        matrix=[{"path": "parameters.speed", "values": [2, 3, 4]}],
        parallelism=1,
    )
    operator = restarts(lab)
    lab.apply(sweep, beside)
    status = lab.completed("misbehaving", 900)
    assert status["failed"] == sum(phase == FAILED for phase, *_ in ENDS.values())
    assert lab.completed("beside")["succeeded"] == 3
    assert restarts(lab) == operator
    return {run["spec"]["parameters"]["mode"]: run for run in lab.runs("misbehaving")}


def restarts(lab: Lab) -> list[tuple[str, int]]:
    pods = lab.get("pods", "-l", "app.kubernetes.io/component=operator")["items"]
    return [
        (pod["metadata"]["uid"], status["restartCount"])
        for pod in pods
        for status in pod["status"]["containerStatuses"]
    ]


@pytest.mark.parametrize("mode", ENDS)
def test_misbehaving_ends_with_the_right_reason(misbehaved: dict[str, dict[str, Any]], mode: str) -> None:
    phase, reason, message = ENDS[mode]
    status = misbehaved[mode]["status"]
    assert (status["phase"], status.get("reason")) == (phase, reason), status.get("message")
    assert message in status.get("message", "")
    assert status["attempts"] == 1
    if mode in LASTING:
        assert status["usage"]["wallSeconds"] > 0
        # What is limited is what the kernel charges; what is resident counts shared libraries too.
        assert status["usage"]["memory"]["workingSetPeakBytes"] <= 128 * 2**20


PROBE = r"""
for root in / /proc/[0-9]*/root/; do
    find "$root" \( -path "${root}proc" -o -path "${root}sys" \) -prune -o \
        \( -iname '*groundtruth*' ! -name '*.py' ! -name '*.pyc' -o -name 'synthetic-lidar.txt' \
        -o -name '*.relations' -o -iname '*serviceaccount*' \) -print 2>/dev/null
done | sed 's/^/found /'
cat /proc/[0-9]*/environ 2>/dev/null | tr '\0' '\n' | grep -i -e token -e password | sed 's/^/variable /'
for address in $KUBERNETES_SERVICE_HOST:443 ADDRESSES; do
    perl -MIO::Socket::INET -e 'exit !IO::Socket::INET->new(PeerAddr => $ARGV[0], Timeout => 3)' $address &&
        echo "reached $address" || echo "didn't reach $address"
done
id -u
grep CapEff /proc/self/status
ls dataset
echo done
exit 9
"""


@pytest.fixture(scope="module")
def probe(lab: Lab) -> tuple[dict[str, Any], str]:
    """A run that looks for what it should not have: its pod and what it says."""
    (operator,) = lab.get("pods", "-l", "app.kubernetes.io/component=operator")["items"]
    script = PROBE.replace("ADDRESSES", f"{operator['status']['podIP']}:8080")
    shell = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Algorithm", "metadata": {"name": "probe"}}
    spec = {
        "version": "1",
        "image": "slamhive/shell-algorithm:1.0.0",
        "command": ["sh", "-c", script],
        "modes": [{"name": "lidar", "roles": ["lidar"]}],
        "recording": ["Rosbag1"],
        "output": {"frame": "lidar"},
        "paces": ["Lockstep"],
    }
    lab.apply(shell | {"spec": spec}, lab.run("probe", "probe"))
    status = lab.ended("probe")
    assert status["message"] == "exit code 9: done"
    (pod,) = lab.get("pods", "-l", "slamhive.io/run=probe")["items"]
    return pod, lab.kubectl("logs", "job/probe-1", "-c", "algorithm")


def test_a_run_sees_neither_ground_truth_nor_a_token(lab: Lab, probe: tuple[dict[str, Any], str]) -> None:
    pod, said = probe
    assert [*lab.data.glob("groundtruth/*")], "there is ground truth to be found"
    assert "found" not in said
    assert "variable" not in said
    assert "65532\nCapEff:\t0000000000000000\nrecording.bag\nvariant.json\ndone" in said
    assert pod["spec"]["automountServiceAccountToken"] is False
    assert not [volume for volume in pod["spec"]["volumes"] if "projected" in volume or "secret" in volume]


def selects(policy: dict[str, Any], labels: dict[str, str]) -> bool:
    """Tell whether a NetworkPolicy selects a pod with these labels."""
    selector = policy["spec"]["podSelector"]
    expressions = selector.get("matchExpressions") or []
    assert {one["operator"] for one in expressions} <= {"In"}
    return (selector.get("matchLabels") or {}).items() <= labels.items() and all(
        labels.get(one["key"]) in one["values"] for one in expressions
    )


def test_a_policy_lets_runs_reach_nothing(lab: Lab, probe: tuple[dict[str, Any], str]) -> None:
    labels = probe[0]["metadata"]["labels"]
    selecting = [policy["spec"] for policy in lab.get("networkpolicies")["items"] if selects(policy, labels)]
    assert [{*spec["policyTypes"]} for spec in selecting] == [{"Ingress", "Egress"}]
    assert not any(spec.get("egress") or spec.get("ingress") for spec in selecting)


def test_a_run_reaches_nothing_where_policies_are_enforced(
    lab: Lab, probe: tuple[dict[str, Any], str]
) -> None:
    said = probe[1]
    assert said.count("reach") == 2
    if not enforces_policies(lab):
        pytest.skip("the cluster's network enforces no NetworkPolicy: nothing to see here")
    assert "reached" not in said


def enforces_policies(lab: Lab) -> bool:
    """Tell from a pod behind a policy of its own, and one without, whether policies have an effect."""
    script = "perl -MIO::Socket::INET -e 'exit !IO::Socket::INET->new(PeerAddr => $ARGV[0], Timeout => 3)'"
    wall = {
        "apiVersion": "networking.k8s.io/v1",
        "kind": "NetworkPolicy",
        "metadata": {"name": "wall"},
        "spec": {"podSelector": {"matchLabels": {"behind": "wall"}}, "policyTypes": ["Egress"]},
    }
    lab.apply(wall)
    secure = {
        "allowPrivilegeEscalation": False,
        "capabilities": {"drop": ["ALL"]},
        "runAsNonRoot": True,
        "seccompProfile": {"type": "RuntimeDefault"},
    }
    reached = {}
    for place in ("wall", "nothing"):
        container = {
            "name": "try",
            "image": "slamhive/shell-algorithm:1.0.0",
            "command": ["sh", "-c", f"{script} $KUBERNETES_SERVICE_HOST:443"],
            "securityContext": secure,
        }
        spec = {"restartPolicy": "Never", "automountServiceAccountToken": False, "containers": [container]}
        name = f"behind-{place}"
        metadata = {"name": name, "labels": {"behind": place}}
        lab.apply({"apiVersion": "v1", "kind": "Pod", "metadata": metadata, "spec": spec})

        def phase(name: str = name) -> str:
            return str(lab.get("pod", name)["status"]["phase"])

        until(lambda: phase() in {"Succeeded", "Failed"}, f"pod {name}")
        reached[place] = phase() == "Succeeded"
    assert reached["nothing"], "a pod without a policy reaches the API server"
    return not reached["wall"]


CAN = [
    *((verb, kind) for verb in ("get", "list", "watch") for kind in ("algorithms", "datasets", "pods")),
    *((verb, "jobs") for verb in ("create", "patch", "delete", "watch")),
    *((verb, "mappingruns") for verb in ("create", "patch", "delete", "watch")),
    ("patch", "sweeps/status"),
    ("get", "pods/log"),
    ("list", "pods.metrics.k8s.io"),
    ("create", "events"),
]
CANNOT = [
    *((verb, "secrets") for verb in ("get", "list", "watch", "create")),
    *((verb, "pods") for verb in ("create", "delete", "patch")),
    *(("create", kind) for kind in ("pods/exec", "serviceaccounts/token", "rolebindings", "namespaces")),
    ("get", "nodes"),
]


@pytest.mark.parametrize(
    ("verb", "resource", "answer"), [*((*one, "yes") for one in CAN), *((*one, "no") for one in CANNOT)]
)
def test_rights_of_the_operator(lab: Lab, verb: str, resource: str, answer: str) -> None:
    account = f"--as=system:serviceaccount:{lab.namespace}:slamhive-operator"
    found, _, sub = resource.partition("/")
    more = [f"--subresource={sub}"] if sub else []
    told = lab.cluster.run("auth", "can-i", verb, found, *more, account, "-n", lab.namespace)
    assert told.stdout.split()[0] == answer
    elsewhere = lab.cluster.run("auth", "can-i", verb, found, *more, account, "-n", "default")
    assert elsewhere.stdout.split()[0] == "no"


def test_usage_is_the_kernels_own_account(lab: Lab) -> None:
    """Within 1 %, beside what the node reads of the container's control group every few milliseconds."""
    spec = {"parameters": {"maxRange": 30}, "input": {"frameRate": 4}, "resources": {"cpu": "1"}}
    lab.apply(lab.run("measured", "kiss-icp", **spec))

    def container() -> str:
        pods = lab.get("pods", "-l", "slamhive.io/run=measured")["items"]
        statuses = [status for pod in pods for status in pod["status"].get("containerStatuses") or ()]
        return next(
            (str(one["containerID"]) for one in statuses if one["name"] == "algorithm" and one["started"]), ""
        )

    watch = Watch(until(container, "the container to start", 120, 0.05).rpartition("/")[2])
    usage = lab.evaluated("measured")["usage"]
    account = watch.end(30)
    seconds = usage["cpu"]["seconds"] + (usage.get("readerCpuSeconds") or 0)
    assert seconds == pytest.approx(account.cpu_seconds, rel=0.01)
    assert usage["memory"]["kernelPeakBytes"] == pytest.approx(account.kernel_peak, rel=0.01)
    assert usage["memory"]["workingSetPeakBytes"] == pytest.approx(account.working_set, rel=0.01)
