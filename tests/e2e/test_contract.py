# SPDX-License-Identifier: Apache-2.0
"""Contract of a run on a cluster: the table of behaviours, algorithms that attack, what a run can see."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from executors import table
from executors.cluster import OnCluster
from executors.executor import differences
from onnode import attacking
from onnode.documents import ROOT
from onnode.lab import FRAMES, manifest
from onnode.node import Watch
from testcluster.access import until

from slamhive.data.files.erasing import erase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from executors.executor import Row
    from onnode.lab import Lab

IMAGES = ROOT / "tests" / "images"
FAILED, SUCCEEDED = "Failed", "Succeeded"
LASTING = ("hang", "deaf", "forks", "memory", "log", "flood")
"""Behaviours that last: what ends within milliseconds may leave no figures."""


def test_an_algorithm_in_shell_alone_gets_a_result(lab: Lab) -> None:
    lab.apply_algorithm(IMAGES / "shell-algorithm")
    lab.apply(lab.run("in-shell", "shell-dead-reckoning"))
    status = lab.evaluated("in-shell")
    assert status["phase"] == SUCCEEDED
    assert status["frames"] == {"offered": FRAMES, "processed": FRAMES, "dropped": 0}
    (result,) = status["results"]
    assert result["ate"]["rmse"] > 0.1
    assert result["poses"] == FRAMES
    folder = lab.results / status["folder"]
    assert len((folder / "output" / "trajectory.txt").read_text().splitlines()) == FRAMES
    assert {path.name for path in folder.iterdir()} >= {"summary.json", "usage.csv"}


@pytest.fixture(scope="module")
def behaved(lab: Lab, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Row]]:
    """Outcomes of a sample of the behaviours, with runs of a well-behaved algorithm beside them."""
    beside = manifest(
        "Sweep",
        "beside",
        template={"spec": lab.run("x", "shell-dead-reckoning")["spec"]},
        matrix=[{"path": "parameters.speed", "values": [2, 3, 4]}],
        parallelism=1,
    )
    operator = restarts(lab)
    lab.apply_algorithm(IMAGES / "shell-algorithm")
    lab.apply(beside)
    found = table.carry_out(OnCluster(lab, tmp_path_factory.mktemp("fetched")), table.SAMPLE)
    assert lab.completed("beside")["succeeded"] == 3
    assert restarts(lab) == operator
    yield found
    for folder in lab.results.glob("runs/*/*/output/d"):
        erase(folder)  # pytest can't remove folders that are as deep


def restarts(lab: Lab) -> list[tuple[str, int]]:
    pods = lab.get("pods", "-l", "app.kubernetes.io/component=operator")["items"]
    return [
        (pod["metadata"]["uid"], status["restartCount"])
        for pod in pods
        for status in pod["status"]["containerStatuses"]
    ]


@pytest.mark.parametrize("name", table.expected(OnCluster.name, table.SAMPLE))
def test_a_cluster_makes_of_it_what_the_table_says(name: str, behaved: dict[str, Row]) -> None:
    """Counterpart of what tests/contract/test_process.py says of a workstation."""
    assert differences(behaved[name], table.expected(OnCluster.name)[name]) == []


@pytest.mark.parametrize("name", LASTING)
def test_what_lasts_has_figures(lab: Lab, behaved: dict[str, Row], name: str) -> None:
    runs = {run["spec"]["parameters"]["behaviour"]: run["status"] for run in lab.runs("behaviours")}
    usage = runs[name]["usage"]
    assert usage["wallSeconds"] > 0
    # What is limited is what the kernel charges; what is resident counts shared libraries too.
    assert usage["memory"]["workingSetPeakBytes"] <= 128 * 2**20


@pytest.fixture(scope="module")
def attacks(lab: Lab) -> dict[str, dict[str, Any]]:
    """Runs that reached for their monitor, by what they tried."""
    lab.apply(attacking.algorithm("slamhive/slamhive:0.1.0"))
    template = lab.run("x", "attacking", retries=0, evaluate=False)["spec"]
    matrix = [{"path": "parameters.act", "values": attacking.ACTS}]
    sweep = manifest("Sweep", "attacks", template={"spec": template}, matrix=matrix, parallelism=2)
    lab.apply(sweep)
    lab.completed("attacks", 600)
    found = {}
    for run in lab.runs("attacks"):
        said = lab.kubectl("logs", f"job/{run['metadata']['name']}-1", "-c", "algorithm")
        found[run["spec"]["parameters"]["act"]] = run["status"] | {"said": said}
    return found


def test_figures_come_from_a_process_that_the_measured_program_cannot_touch(
    attacks: dict[str, dict[str, Any]],
) -> None:
    status = attacks["look"]
    assert (status["phase"], status["said"].count("closed")) == (SUCCEEDED, 11)
    assert "OPEN" not in status["said"]
    assert "suspect" not in status["usage"]


@pytest.mark.parametrize("act", attacking.SUSPECT)
def test_who_meddles_with_the_monitor_is_suspected(attacks: dict[str, dict[str, Any]], act: str) -> None:
    status = attacks[act]
    held = {item["type"]: item["message"] for item in status["conditions"]}
    assert attacking.SUSPECT[act] in status["usage"]["suspect"]
    assert held["UsageSuspect"] == status["usage"]["suspect"]
    assert status["usage"]["cpu"]["totalSeconds"] >= 1.0


def test_who_kills_the_monitor_has_no_result(attacks: dict[str, dict[str, Any]]) -> None:
    status = attacks["kill"]
    assert (status["phase"], status["reason"]) == (FAILED, "SystemFault")
    assert "its monitor was ended while the algorithm ran" in status["message"]
    assert "usage" not in status


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
    assert "65532\nCapEff:\t0000000000000000\nframes.txt\nrecording.bag\nvariant.json\ndone" in said
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


def test_usage_is_the_kernels_own_account(lab: Lab) -> None:
    """Beside what the node reads of the container's control group every few milliseconds.

    What the kernel sums or keeps itself agrees within 1 %. The working set is looked at now and then by both:
    a peak of some milliseconds may be seen by one alone, the more so on a busy node.
    """
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
    assert usage["memory"]["workingSetPeakBytes"] == pytest.approx(account.working_set, rel=0.2)
