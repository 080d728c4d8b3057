# SPDX-License-Identifier: Apache-2.0
"""Tests of the choice of a cluster for tests, and of the line printed for each thing that is missing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from testcluster import choice, images, kind, missing, programs
from testcluster.components import PAUSE_IMAGE
from testcluster.errors import ClusterError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture
def offers(monkeypatch: pytest.MonkeyPatch) -> Callable[[list[str], list[str]], None]:
    """Let the machine lack things."""

    def lack(local: list[str], docker: list[str]) -> None:
        monkeypatch.setattr(missing, "missing", lambda: local)
        monkeypatch.setattr(kind, "missing", lambda: docker)
        monkeypatch.setattr(programs, "absent", lambda *_: [])

    return lack


@pytest.mark.parametrize(
    ("local", "docker", "mode"),
    [
        ([], [], "local"),
        ([], ["no docker"], "local"),
        (["no root"], [], "kind"),
        (["no root"], ["no docker"], "none"),
    ],
)
def test_the_machine_decides(
    offers: Callable[..., None], local: list[str], docker: list[str], mode: str
) -> None:
    offers(local, docker)
    chosen = choice.choose({})
    assert chosen.mode == mode
    assert not chosen.asked
    assert ("no root" in chosen.sentence()) == (mode == "none")


@pytest.mark.parametrize("mode", choice.MODES)
def test_the_variable_decides(offers: Callable[..., None], mode: str) -> None:
    offers(["no root"], ["no docker"])
    chosen = choice.choose({choice.VARIABLE: mode})
    assert (chosen.mode, chosen.asked) == (mode, True)
    assert bool(chosen.problems) == (
        mode in {"local", "kind"} or (mode == "current" and bool(chosen.problems))
    )


def test_somebodys_cluster_is_never_chosen_by_itself(offers: Callable[..., None]) -> None:
    offers(["no root"], ["no docker"])
    assert choice.choose({"KUBECONFIG": "somebodys"}).mode == "none"


def test_an_unknown_mode_is_refused() -> None:
    with pytest.raises(ClusterError, match="expected one of none, local, kind, current"):
        choice.choose({choice.VARIABLE: "minikube"})


def test_programs_that_are_not_built_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(missing, "missing", list)
    monkeypatch.setattr(programs, "absent", lambda *_: ["etcd"])
    monkeypatch.setattr(kind, "missing", lambda: ["no docker"])
    assert "its programs are not built (etcd): make cluster-build" in choice.choose({}).sentence()
    assert choice.choose({}, building=True).mode == "local"


def test_what_is_missing_is_named_with_how_to_get_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setattr(programs, "home", lambda: tmp_path)
    monkeypatch.setattr(missing.shutil, "which", lambda *_, **__: None)
    root, go, packages = missing.missing()
    assert root == "it needs root: sudo make test-cluster"
    assert go == "it needs Go 1.21 or newer on the PATH: go.dev/dl"
    assert packages.startswith("it needs Debian's packages: apt-get install containerd")


@pytest.mark.parametrize(
    ("version", "fine"),
    [("go1.19.8", False), ("go1.21.0", True), ("go1.26.8", True), ("go2.0", True), ("devel", False)],
)
def test_old_gos_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, version: str, fine: bool
) -> None:
    program = tmp_path / "go"
    program.write_text(f"#!/bin/sh\necho go version {version} linux/amd64\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    assert (missing._problem_of_go() is None) == fine


def test_every_program_has_a_pinned_module() -> None:
    modules = {module for module, _ in programs.PROGRAMS.values()}
    folder = programs.MODULES
    assert modules == {path.name for path in folder.iterdir()}
    for module in modules - {"pause"}:
        assert (folder / module / "go.sum").stat().st_size > 0
    assert programs.KUBERNETES in (folder / "kubernetes" / "go.mod").read_text()


def test_other_pins_make_other_programs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(programs, "MODULES", tmp_path)
    found = set()
    for pins in ("one", "two"):
        (tmp_path / "pause").mkdir(exist_ok=True)
        (tmp_path / "pause" / "go.mod").write_text(pins)
        found.add(programs.path_of("pause"))
    assert len(found) == 2


def test_an_image_is_the_same_each_time() -> None:
    made = [images.archive(PAUSE_IMAGE, {"pause": (b"x", 0o755)}, ["/pause"]) for _ in range(2)]
    assert made[0] == made[1]


def test_kind_gets_the_repositorys_configuration(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    log = tmp_path / "log"
    for name in ("kind", "docker", "kubectl"):
        (tmp_path / name).write_text(f'#!/bin/sh\necho {name} "$@" >> {log}\n')
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setenv("SLAMHIVE_CLUSTER_HOME", str(tmp_path / "home"))
    config = tmp_path / "kind-config.yaml"
    config.write_bytes(kind.CONFIG.read_bytes())
    monkeypatch.setattr(kind, "CONFIG", config)
    cluster = kind.Kind("x")
    access = cluster.up()
    access.load("example/image:1")
    cluster.down()
    lines = log.read_text()
    assert f"kind create cluster --name slamhive-test-x --config {config} --kubeconfig" in lines
    assert "kind load docker-image example/image:1 --name slamhive-test-x" in lines
    assert "kind delete cluster --name slamhive-test-x" in lines
    assert (tmp_path / "kind-data" / "results").is_dir()


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("slamhive/x:1", "docker.io/slamhive/x:1"),
        ("x:1", "docker.io/library/x:1"),
        ("localhost/x:1", "localhost/x:1"),
        ("registry.example:5000/x:1", "registry.example:5000/x:1"),
    ],
)
def test_an_image_is_loaded_under_the_name_that_pods_ask_for(name: str, full: str) -> None:
    assert images.full_name(name) == full
