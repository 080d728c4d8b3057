# SPDX-License-Identifier: Apache-2.0
"""From `kubectl apply` to an algorithm's first instruction, on a real node: needs root and built images.

A MappingRun, whose variant is ready, and the same container as a plain Job, in turns on the same cluster. The
program is a shell whose first instruction prints the time.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import operating
from testcluster.lab import algorithm, manifest, run

if TYPE_CHECKING:
    from testcluster.access import Cluster

SAMPLES = 10
LIMIT_SECONDS = 1.0
WHERE = "bench-start"
USER = 65532
IMAGES = {"slamhive": "slamhive/slamhive:0.1.0", "shell-algorithm": "slamhive/shell-algorithm:1.0.0"}
POSE = "0 0 0 0 0 0 1"
PROGRAM = f"date +begun:%s.%N; printf '1 {POSE}\\n2 {POSE}\\n' > /slamhive/output/trajectory.txt"
SIZE = {"cpu": "100m", "memory": "128Mi"}
PIECE = {"seed": 5, "sensors": ["Lidar"], "durationSeconds": 10, "loops": 0.2}


def built() -> bool:
    """Have the images built; what is up to date is not built again."""
    script = Path(__file__).parents[2] / "images" / "build"
    result = subprocess.run([script, *IMAGES], capture_output=True, text=True, check=False)
    return result.returncode == 0


def volumes(folder: Path) -> list[dict[str, Any]]:
    """Return the two volumes, on folders of this machine, and the claims on them."""
    objects: list[dict[str, Any]] = []
    anywhere = {"key": "kubernetes.io/os", "operator": "In", "values": ["linux"]}
    size = {"storage": "1Gi"}
    common = {"accessModes": ["ReadWriteOnce"], "storageClassName": ""}
    for name in ("results", "data"):
        (folder / name).mkdir()
        volume = {"name": f"{WHERE}-{name}"}
        disk = common | {
            "capacity": size,
            "claimRef": {"namespace": WHERE, "name": name},
            "local": {"path": str(folder / name)},
            "nodeAffinity": {"required": {"nodeSelectorTerms": [{"matchExpressions": [anywhere]}]}},
        }
        wish = common | {"resources": {"requests": size}, "volumeName": volume["name"]}
        claim = {"name": name, "namespace": WHERE}
        objects += [
            {"apiVersion": "v1", "kind": "PersistentVolume", "metadata": volume, "spec": disk},
            {"apiVersion": "v1", "kind": "PersistentVolumeClaim", "metadata": claim, "spec": wish},
        ]
    return objects


def job(name: str) -> dict[str, Any]:
    """Return the container as a plain Job."""
    container = {
        "name": "main",
        "image": IMAGES["shell-algorithm"],
        "imagePullPolicy": "IfNotPresent",
        "command": ["sh", "-c", PROGRAM],
        "resources": {"requests": SIZE, "limits": SIZE},
        "securityContext": {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        },
        "volumeMounts": [{"name": "output", "mountPath": "/slamhive/output"}],
    }
    pod = {
        "restartPolicy": "Never",
        "automountServiceAccountToken": False,
        "securityContext": {
            "runAsNonRoot": True,
            "runAsUser": USER,
            "fsGroup": USER,
            "seccompProfile": {"type": "RuntimeDefault"},
        },
        "containers": [container],
        "volumes": [{"name": "output", "emptyDir": {}}],
    }
    spec = {"backoffLimit": 0, "template": {"spec": pod}}
    return {"apiVersion": "batch/v1", "kind": "Job", "metadata": {"name": name}, "spec": spec}


def apply(access: Cluster, body: dict[str, Any]) -> float:
    """Apply an object as a user does; returns when that began, s since 1970."""
    began = time.time()
    access.kubectl("apply", "-n", WHERE, "-f", "-", stdin=json.dumps(body))
    return began


def first_instruction(access: Cluster, pod: str, container: str) -> float:
    """Return the time a program began, s since 1970."""
    said = access.kubectl("logs", "-n", WHERE, pod, "-c", container)
    return float(said.partition("begun:")[2].split()[0])


def of_run(access: Cluster, name: str) -> float:
    """Return the time from a MappingRun to its algorithm's first instruction, s."""
    began = apply(access, run(name, resources=SIZE))

    def ended() -> bool:
        status = access.get("mappingrun", name, "-n", WHERE).get("status") or {}
        if status.get("phase") in {"Failed", "Cancelled"}:
            raise SystemExit(f"{name}: {status}")
        return bool(status.get("phase") == "Succeeded")

    operating.until(ended, name, 120, 0.5)
    pods = access.get("pods", "-n", WHERE, "-l", f"slamhive.io/run={name},slamhive.io/role=run")["items"]
    return first_instruction(access, pods[0]["metadata"]["name"], "algorithm") - began


def of_job(access: Cluster, name: str) -> float:
    """Return the time from a plain Job to its program's first instruction, s."""
    began = apply(access, job(name))
    operating.until(
        lambda: access.get("job", name, "-n", WHERE).get("status", {}).get("succeeded"), name, 120, 0.5
    )
    pods = access.get("pods", "-n", WHERE, "-l", f"batch.kubernetes.io/job-name={name}")["items"]
    return first_instruction(access, pods[0]["metadata"]["name"], "main") - began


def catalog() -> list[dict[str, Any]]:
    """Return an Algorithm that tells when it began, and a small Dataset that is generated."""
    icp = algorithm(image=IMAGES["shell-algorithm"], command=["sh", "-c", PROGRAM], output={"frame": "lidar"})
    lidar = PIECE | {"lidar": {"rings": 4, "columns": 36}}
    return [icp, manifest("Dataset", "hall", recording={"synthetic": lidar})]


def bench(access: Cluster, folder: Path) -> None:
    """Report both times."""
    labels = {"pod-security.kubernetes.io/enforce": "restricted"}
    access.apply({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": WHERE, "labels": labels}})
    access.apply(*volumes(folder), *catalog(), namespace=WHERE)
    for image in IMAGES.values():
        access.load(f"docker.io/{image}")
    with operating.operator(access, WHERE, {}, image=IMAGES["slamhive"]):
        of_run(access, "first-run")
        of_job(access, "first-job")
        runs, jobs = [], []
        for number in range(SAMPLES):
            runs.append(of_run(access, f"run-{number}"))
            jobs.append(of_job(access, f"job-{number}"))
    ours, plain = statistics.median(runs), statistics.median(jobs)
    operating.report(
        "from kubectl apply of a run to its algorithm's first instruction",
        f"{ours:.2f} s ({min(runs):.2f} to {max(runs):.2f} s)",
        f"{plain:.2f} s as a plain Job ({min(jobs):.2f} to {max(jobs):.2f} s): {ours - plain:.2f} s more, "
        f"limit {LIMIT_SECONDS:g} s; {operating.load()}",
    )


def main() -> None:
    """Run the benchmark."""
    if why := operating.lacking():
        print(why)
        return
    if not built():
        print("the images can't be built here: no figure for the start of a run")
        return
    with tempfile.TemporaryDirectory() as name, operating.cluster("bench-node", node=True) as access:
        Path(name).chmod(0o755)
        bench(access, Path(name))


if __name__ == "__main__":
    main()
