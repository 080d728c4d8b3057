# SPDX-License-Identifier: Apache-2.0
"""Files of runs fetched by somebody who may edit in the namespace, and no more."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from onnode.documents import ROOT
from onnode.lab import manifest
from testcluster.access import until

from slamhive.archive import Archive
from slamhive.local.home.folder import Home

if TYPE_CHECKING:
    from onnode.lab import Lab

SWEEP = "fetched"
MAP = "output/map.bin"
MAP_BYTES = 64 << 20
PAUSE = """
import os, signal
whole = os.write
def write(descriptor, data):
    written = whole(descriptor, data)
    path = os.readlink(f"/proc/self/fd/{descriptor}")
    if path.endswith("map.bin") and os.fstat(descriptor).st_size > 1 << 20:
        os.write = whole
        os.kill(os.getpid(), signal.SIGSTOP)
    return written
os.write = write
"""
"""A command with this as sitecustomize stops in the middle of the map, until it is told to go on."""


@dataclass(frozen=True)
class User:
    """Somebody with a kubeconfig and a home.

    Attributes:
        home: the home.
        environment: variables of commands.
    """

    home: Path
    environment: dict[str, str]

    def command(self, *words: str) -> subprocess.Popen[str]:
        """Begin a command."""
        program = str(Path(sys.executable).with_name("slamhive"))
        return subprocess.Popen(
            [program, *words],
            env=self.environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )

    def type(self, *words: str) -> tuple[int, str]:
        """Run a command; returns its exit code and what it says."""
        process = self.command(*words)
        told, _ = process.communicate(timeout=600)
        return process.returncode, " ".join(told.split())


@pytest.fixture(scope="module")
def user(lab: Lab, tmp_path_factory: pytest.TempPathFactory) -> User:
    """Somebody with the cluster's role `edit` in the namespace."""
    lab.kubectl("create", "serviceaccount", "student")
    lab.kubectl(
        "create", "rolebinding", "student", "--clusterrole=edit", f"--serviceaccount={lab.namespace}:student"
    )
    token = lab.kubectl("create", "token", "student", "--duration=2h").strip()
    config = yaml.safe_load(lab.cluster.kubeconfig.read_text())
    config["users"] = [{"name": "student", "user": {"token": token}}]
    for context in config["contexts"]:
        context["context"] |= {"user": "student", "namespace": lab.namespace}
    folder = tmp_path_factory.mktemp("user")
    (folder / "config").write_text(yaml.safe_dump(config))
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SLAMHIVE_")}
    more = {"KUBECONFIG": str(folder / "config"), "SLAMHIVE_HOME": str(folder / "home")}
    return User(folder / "home", kept | more)


@pytest.fixture(scope="module")
def runs(lab: Lab) -> list[dict[str, Any]]:
    """Two finished runs, one of which left a large map."""
    lab.apply_algorithm(ROOT / "tests" / "images" / "shell-algorithm")
    lab.apply(
        manifest(
            "Sweep",
            SWEEP,
            template={"spec": lab.run("x", "shell-dead-reckoning")["spec"]},
            matrix=[{"path": "parameters.speed", "values": [2, 3]}],
        )
    )
    assert lab.completed(SWEEP)["succeeded"] == 2
    found = lab.runs(SWEEP)
    with (lab.results / found[1]["status"]["folder"] / MAP).open("wb") as file:
        for number in range(MAP_BYTES >> 20):
            file.write(number.to_bytes(4, "big") * (1 << 18))
    return found


def senders(lab: Lab) -> list[str]:
    """Return the names of Jobs and pods that send files; not those of the operator, which read summaries."""
    items = lab.get("jobs,pods", "-l", "slamhive.io/role=read")["items"]
    names = [item["metadata"]["name"] for item in items]
    return [name for name in names if name.startswith("fetch-")]


def here(user: User, run: dict[str, Any]) -> Path:
    return user.home / "runs" / SWEEP / f"{run['metadata']['name']}@{run['metadata']['uid'][:8]}"


def equal(lab: Lab, user: User, run: dict[str, Any], path: str) -> bool:
    there = lab.results / run["status"]["folder"] / path
    inner = Path("run") if path.startswith("output") else Path()
    return there.read_bytes() == (here(user, run) / inner / path).read_bytes()


def test_an_interrupted_fetch_leaves_no_pod_and_is_taken_up(
    lab: Lab, user: User, runs: list[dict[str, Any]], tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text(PAUSE)
    paused = User(user.home, user.environment | {"PYTHONPATH": str(tmp_path)})
    process = paused.command("fetch", SWEEP, "--files")
    partial = here(user, runs[1]).parent / f".{here(user, runs[1]).name}.fetching" / "run" / MAP
    _, status = os.waitpid(process.pid, os.WUNTRACED)
    assert os.WIFSTOPPED(status), process.communicate()[0]
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGCONT)
    told, _ = process.communicate(timeout=150)
    assert process.returncode == 130, told
    assert "the same command goes on from here" in " ".join(told.split())
    part = partial.stat().st_size
    assert 0 < part < MAP_BYTES
    until(lambda: not senders(lab), "the pod to go", 150)
    code, told = user.type("fetch", SWEEP, "--files")
    assert code == 0, told
    assert equal(lab, user, runs[1], MAP)
    until(lambda: not senders(lab), "the pod to go", 150)


def test_what_was_fetched_is_a_run_of_this_machine(lab: Lab, user: User, runs: list[dict[str, Any]]) -> None:
    code, told = user.type("fetch", SWEEP, "--files")
    assert code == 0, told
    assert "all files are in" in told
    for run in runs:
        for path in ("output/trajectory.txt", "usage.csv", "summary.json"):
            assert equal(lab, user, run, path), path
        assert (here(user, run) / "log.txt").exists()
    with Archive.open(Home.at(user.home).archive_url) as archive:
        records = [*archive.runs(sweep=SWEEP)]
    assert [record.folder for record in records] == [str(here(user, run)) for run in runs]


def test_a_trajectory_that_is_another_one_is_refused(
    lab: Lab, user: User, runs: list[dict[str, Any]], tmp_path: Path
) -> None:
    trajectory = lab.results / runs[0]["status"]["folder"] / "output" / "trajectory.txt"
    content = trajectory.read_bytes()
    trajectory.write_bytes(content.replace(b"1", b"2", 1))
    other = User(tmp_path, user.environment | {"SLAMHIVE_HOME": str(tmp_path)})
    try:
        code, told = other.type("fetch", runs[0]["metadata"]["name"], "--files")
    finally:
        trajectory.write_bytes(content)
    assert code == 1
    assert "not the one that the run reported" in told
    assert not here(other, runs[0]).exists()


def test_who_may_only_look_is_told_what_is_missing(
    lab: Lab, user: User, runs: list[dict[str, Any]], tmp_path: Path
) -> None:
    lab.kubectl("create", "serviceaccount", "guest")
    lab.kubectl(
        "create", "rolebinding", "guest", "--clusterrole=view", f"--serviceaccount={lab.namespace}:guest"
    )
    token = lab.kubectl("create", "token", "guest").strip()
    config = yaml.safe_load(Path(user.environment["KUBECONFIG"]).read_text())
    config["users"] = [{"name": "student", "user": {"token": token}}]
    (tmp_path / "config").write_text(yaml.safe_dump(config))
    more = {"SLAMHIVE_HOME": str(tmp_path), "KUBECONFIG": str(tmp_path / "config")}
    until(lambda: not senders(lab), "the pods of earlier fetches to go", 240)
    code, told = User(tmp_path, user.environment | more).type("fetch", SWEEP, "--files")
    assert code == 1
    assert "pods/exec" in told
    assert not senders(lab)
