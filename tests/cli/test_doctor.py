# SPDX-License-Identifier: Apache-2.0
"""Tests of `slamhive doctor`: each thing that may be missing, and looks that never answer."""

from __future__ import annotations

import asyncio
import json
import socket
import sqlite3
import sys
import threading
from contextlib import asynccontextmanager, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from aiohttp import web

from slamhive import __version__
from slamhive.cli import doctor as cli
from slamhive.cli import main
from slamhive.kube.api.kinds import OUR_KINDS
from slamhive.kube.user import readiness as cluster
from slamhive.local.home.catalog import Workshop, load_workshop
from slamhive.local.home.folder import Home
from slamhive.local.programs import readiness, rosreadiness
from slamhive.model.extras import how_to_install
from slamhive.model.readiness import ReadinessRow, State, missing, there
from slamhive.playback.ros import PACKAGES, find_ros

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

ARCHIVES = Path(__file__).parents[1] / "archive"


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str]]:
    """Runs the command on an empty home without a cluster; returns exit code and output."""
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("KUBECONFIG", str(tmp_path / "none"))
    monkeypatch.delenv("SLAMHIVE_ARCHIVE", raising=False)
    monkeypatch.setattr(cli, "PATIENCE_SECONDS", 240.0)  # others may have taken the cores

    def run(*words: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["slamhive", "doctor", *words])
        code = 0
        try:
            main.main()
        except SystemExit as end:
            code = int(end.code or 0)
        return code, capsys.readouterr().out

    return run


@pytest.mark.timeout(300)
def test_all_that_is_needed_is_there_on_an_empty_home(command: Callable[..., tuple[int, str]]) -> None:
    code, out = command("--json")
    told = json.loads(out)
    rows = {row["check"]: row for row in told["rows"]}
    assert (code, told["ready"], told["version"]) == (0, True, __version__)
    assert {name for name, row in rows.items() if row["needed"]} == {"Python", "packages", "disk", "archive"}
    assert {
        "algorithms",
        "ROS 1",
        "ROS 2",
        "podman",
        "docker",
        "cgroup accounting",
        "memory limit",
    } <= rows.keys()
    assert {"cores", "clock", "load", "memory", "browser, TeX", "cluster"} <= rows.keys()
    assert rows["cluster"]["state"] == "missing"
    assert rows["cluster"]["helps"] == "set KUBECONFIG"
    # Whatever is less than it could be says what that costs.
    assert all(row["costs"] for row in rows.values() if row["state"] in {"limited", "missing"})


@pytest.mark.timeout(300)
def test_a_broken_archive_is_exit_code_1(command: Callable[..., tuple[int, str]], tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home/archive.sqlite").write_text("no database at all, but longer than a header of one " * 20)
    code, out = command()
    assert code == 1
    assert "the file is not an SQLite database" in " ".join(out.split())
    assert out.splitlines()[-1] == "nothing can be run before this is mended: archive"


def test_what_never_answers_is_not_waited_for() -> None:
    forever = threading.Event()
    looks = {
        "b": lambda: there("b", "fine"),
        "a": lambda: [ReadinessRow("a", State.THERE, str(forever.wait()))],
    }
    moments = iter([0.0, 0.0, 61.0])  # the end, b's turn, a's turn
    rows = cli.examine(looks, 60.0, lambda: next(moments))
    forever.set()
    assert [(row.check, row.state) for row in rows] == [("b", State.THERE), ("a", State.UNKNOWN)]
    assert rows[1].found == "no answer within 60 s"


def test_a_look_that_fails_hides_no_other() -> None:
    def fails() -> ReadinessRow:
        raise ValueError("odd file")

    rows = cli.examine({"disk": fails, "load": lambda: there("load", "low")}, 60.0)
    assert [row.found for row in rows] == ["ValueError: odd file", "low"]
    assert [row.stops for row in rows] == [True, False]
    assert not missing("cluster", "none", "").stops


@pytest.mark.parametrize(
    ("files", "state", "words"),
    [
        ({}, State.UNKNOWN, "virtual machines"),
        ({"cpu0/cpufreq/scaling_governor": "performance"}, State.THERE, "governor performance"),
        (
            {"cpu0/cpufreq/scaling_governor": "powersave", "intel_pstate/no_turbo": "0"},
            State.LIMITED,
            "governor powersave, turbo on",
        ),
        (
            {"cpu1/cpufreq/scaling_governor": "performance", "cpufreq/boost": "0"},
            State.THERE,
            "governor performance, turbo off",
        ),
    ],
)
def test_what_moves_the_clock(tmp_path: Path, files: dict[str, str], state: State, words: str) -> None:
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n")
    row = readiness.clock(tmp_path)
    assert row.state is state
    assert words in row.found
    assert (state is State.LIMITED) == ("cpupower" in row.helps)


def test_a_busy_machine_and_little_memory(tmp_path: Path) -> None:
    assert readiness.load((0.9, 0.5, 0.4), 4).state is State.THERE
    assert readiness.load((1.1, 0.5, 0.4), 4).state is State.LIMITED
    facts = tmp_path / "meminfo"
    facts.write_text("MemTotal:       16000000 kB\nMemAvailable:    1048576 kB\nHugePages_Total:       0\n")
    row = readiness.memory(facts)
    assert row.state is State.LIMITED
    assert row.found.startswith("1.0 GiB of 15.3 GiB free")


def test_packages_that_are_missing_or_too_old(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [
        *("numpy>=1.26", "pyyaml>=99", "no-such-package>=1", "elsewhere>=1; sys_platform == 'win32'"),
        *("pandas>=2; extra == 'pandas'", "absent[all]>=1; extra == 'plot'"),
    ]
    monkeypatch.setattr(readiness.metadata, "requires", lambda _: lines)
    rows = {row.check: row for row in readiness.packages()}
    assert rows["packages"].stops
    assert rows["packages"].found.startswith("2 of 4 are not there: pyyaml ")
    assert rows["packages"].found.endswith("(needs 99), no-such-package")
    assert rows["extra plot"].found == "without absent"
    assert rows["extra plot"].costs == "no figures"
    assert rows["extra plot"].helps == how_to_install("plot")


def test_what_is_not_installed_is_unknown() -> None:
    (row,) = readiness.packages("no-such-distribution")
    assert row.state is State.UNKNOWN


def test_without_an_engine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    rows = list(readiness.engines())
    assert [(row.check, row.state, row.found) for row in rows] == [
        ("podman", State.MISSING, "podman isn't installed"),
        ("docker", State.MISSING, "docker isn't installed"),
    ]
    assert {row.helps for row in rows} == {"apt-get install podman catatonit"}


def test_without_ros_it_is_missing_only_where_an_algorithm_takes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rosreadiness, "find_ros", lambda: None)
    first = rosreadiness.ros1(Workshop())
    assert (first.check, first.state) == ("ROS 1", State.UNNEEDED)


def test_of_half_a_ros_the_missing_packages_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    program = tmp_path / "dpkg-query"
    there = "".join(f"{name} installed\\n" for name in PACKAGES if name not in {"rosout", "python3-rosbag"})
    program.write_text(f"#!/bin/sh\nprintf '{there}rosout config-files\\n'\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    find_ros.cache_clear()
    first = rosreadiness.ros1(load_workshop(Home.at(tmp_path / "home")))
    find_ros.cache_clear()
    assert first.found == "not whole, without python3-rosbag, rosout"
    assert first.helps.endswith("(on Debian 12: apt-get install python3-rosbag rosout)")


@pytest.mark.parametrize("kept", [True, False, None])
def test_a_cgroup_that_is_tried_goes_again(monkeypatch: pytest.MonkeyPatch, kept: bool | None) -> None:
    class Group:
        source = type("Source", (), {"name": "cgroup-v2"})
        removed = 0

        def limit(self, memory: int, tasks: None) -> bool:
            return bool(kept)

        def remove(self) -> None:
            self.removed += 1

    group = Group()
    monkeypatch.setattr(readiness, "make_run_cgroup", lambda _: None if kept is None else group)
    rows = list(readiness.accounting())
    assert [row.check for row in rows] == ["cgroup accounting", "memory limit"]
    assert [row.state is State.THERE for row in rows] == [kept is not None, bool(kept)]
    assert group.removed == (kept is not None)


def test_a_home_that_is_no_folder_or_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    row = readiness.disk(Home.at(tmp_path / "file/home"))
    assert row.stops
    assert row.found == f"{tmp_path / 'file'} can't be written"
    for free, state in ((1 << 20, State.MISSING), (5 << 30, State.LIMITED), (1 << 40, State.THERE)):
        monkeypatch.setattr(
            readiness.shutil, "disk_usage", lambda _, free=free: type("Usage", (), {"free": free})
        )
        assert readiness.disk(Home.at(tmp_path / "home")).state is state


def test_an_archive_of_an_earlier_version_is_to_be_upgraded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SLAMHIVE_ARCHIVE", raising=False)
    with closing(sqlite3.connect(tmp_path / "archive.sqlite")) as connection:
        connection.executescript((ARCHIVES / "version1.sql").read_text())
    row = readiness.archive(Home.at(tmp_path))
    assert (row.state, row.helps, row.stops) == (State.LIMITED, "slamhive archive upgrade", False)
    assert readiness.archive(Home.at(tmp_path / "new")).state is State.THERE


@asynccontextmanager
async def serving(answers: dict[str, Any], rights: Callable[[dict[str, str]], bool]) -> AsyncIterator[int]:
    """Serve answers by path as an API server would, and reviews of rights, on a port that is yielded."""

    async def answer(request: web.Request) -> web.Response:
        if request.path.endswith("selfsubjectaccessreviews"):
            asked = (await request.json())["spec"]["resourceAttributes"]
            return web.json_response({"status": {"allowed": rights(asked)}}, status=201)
        found = answers.get(request.path)
        body = {"kind": "Status", "code": 404, "reason": "NotFound", "message": "not here"}
        return web.json_response(body if found is None else found, status=404 if found is None else 200)

    app = web.Application()
    app.router.add_route("*", "/{path:.*}", answer)
    runner = web.AppRunner(app)
    await runner.setup()
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        await web.SockSite(runner, listener).start()
        yield listener.getsockname()[1]
        await runner.cleanup()


def kubeconfig(folder: Path, port: int) -> str:
    """Write a kubeconfig that leads to a port of this machine, and return its path."""
    path = folder / "kubeconfig"
    context = {"cluster": "here", "user": "me", "namespace": "lab"}
    body = {
        "current-context": "here",
        "contexts": [{"name": "here", "context": context}],
        "clusters": [{"name": "here", "cluster": {"server": f"http://127.0.0.1:{port}"}}],
        "users": [{"name": "me", "user": {"token": "secret"}}],
    }
    path.write_text(yaml.safe_dump({"apiVersion": "v1", "kind": "Config"} | body))
    return str(path)


OPERATOR = {"metadata": {"name": "op", "labels": {"app.kubernetes.io/version": "0.0.1"}}}
SERVED = {
    "/version": {"gitVersion": "v1.34.4"},
    "/apis/slamhive.io/v1alpha1": {"resources": [{"name": kind.plural} for kind in OUR_KINDS]},
    "/apis/apps/v1/namespaces/lab/deployments": {"items": [OPERATOR | {"status": {"availableReplicas": 1}}]},
    "/apis/metrics.k8s.io/v1beta1/namespaces/lab/pods": {"items": []},
}
OLD_CRDS = {
    "components": {
        "schemas": {
            kind: {"x-kubernetes-group-version-kind": [{"kind": str(kind)}], "properties": {}}
            for kind in OUR_KINDS
        }
    }
}


@pytest.mark.timeout(120)
async def test_a_cluster_is_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "PATIENCE_SECONDS", 60.0)
    async with serving(SERVED, lambda asked: asked["subresource"] != "exec") as port:
        monkeypatch.setenv("KUBECONFIG", kubeconfig(tmp_path, port))
        rows = {row.check: row for row in await cluster.look()}
        monkeypatch.setitem(SERVED, "/openapi/v3/apis/slamhive.io/v1alpha1", OLD_CRDS)
        old = {row.check: row for row in await cluster.look()}["cluster"]
    assert rows["cluster"].found == "context 'here', namespace lab, Kubernetes v1.34.4, with our CRDs"
    assert old.state is State.LIMITED
    assert "with our CRDs; the CRDs are older than this version and don't know Algorithm." in old.found
    assert "helm upgrade slamhive-crds" in str(old.helps)
    assert rows["operator"].state is State.LIMITED
    assert rows["operator"].found == f"version 0.0.1, here is {__version__}"
    assert rows["metrics API"].state is State.THERE
    assert rows["rights"].found == "this user may not create pods/exec"
    assert rows["rights"].costs == "no fetch --files"


@pytest.mark.timeout(120)
async def test_a_cluster_without_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "PATIENCE_SECONDS", 60.0)
    idle = {"/apis/apps/v1/namespaces/lab/deployments": {"items": [OPERATOR | {"status": {}}]}}
    without = {path: body for path, body in SERVED.items() if "metrics" not in path} | idle
    async with serving(without, lambda _: True) as port:
        monkeypatch.setenv("KUBECONFIG", kubeconfig(tmp_path, port))
        rows = {row.check: row for row in await cluster.look()}
        bare = {path: body for path, body in without.items() if "slamhive.io" not in path}
        without.clear()
        without.update(bare)
        (no_kinds,) = await cluster.look()
    assert (rows["operator"].state, rows["metrics API"].state) == (State.MISSING, State.MISSING)
    assert rows["rights"].state is State.THERE
    assert "does not know Algorithm" in no_kinds.found
    assert no_kinds.helps == "its administrator installs the charts slamhive-crds and slamhive"


@pytest.mark.timeout(120)
async def test_a_server_that_never_answers_holds_nobody_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "PATIENCE_SECONDS", 0.05)
    with closing(socket.create_server(("127.0.0.1", 0))) as silent:
        monkeypatch.setenv("KUBECONFIG", kubeconfig(tmp_path, silent.getsockname()[1]))
        async with asyncio.timeout(60):
            (row,) = await cluster.look()
    assert (row.check, row.state) == ("cluster", State.MISSING)
    assert row.found == "context 'here', namespace lab: no answer within 0.05 s"
