# SPDX-License-Identifier: Apache-2.0
"""Clusters that are not there, not ready or not open: a sentence, an exit code, no traceback."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from testcluster.lab import algorithm, dataset, sweep

from slamhive.model.extras import how_to_install

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.access import Cluster
    from testcluster.lab import Lab

    from conftest import Desk

COMMANDS = [
    ("submit", "study.yaml"),
    ("status",),
    ("logs", "one"),
    ("cancel", "one"),
    ("fetch", "one"),
    ("run", "study.yaml", "--on", "cluster"),
]


def kubeconfig(server: str = "https://127.0.0.1:1", **context: str) -> dict[str, Any]:
    place = {"cluster": "there", "user": "me", **context}
    return {
        "apiVersion": "v1",
        "kind": "Config",
        "current-context": "here",
        "clusters": [{"name": "there", "cluster": {"server": server}}],
        "users": [{"name": "me", "user": {"token": "t"}}],
        "contexts": [{"name": "here", "context": place}],
    }


def all_objects(desk: Desk) -> None:
    desk.write(algorithm(), dataset(), sweep())


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_no_kubeconfig(bare_desk: Desk, words: tuple[str, ...]) -> None:
    all_objects(bare_desk)
    said = bare_desk.type(*words)
    assert (said.code, said.out) == (1, "")
    assert "no cluster is known: there is no file" in said.text


@pytest.mark.parametrize(
    ("content", "code", "text"),
    [
        ("][", 1, "not a kubeconfig"),
        ("just words", 1, "not a kubeconfig"),
        ("{}", 1, "kubeconfig"),
        (kubeconfig() | {"current-context": ""}, 1, "context"),
        (kubeconfig() | {"current-context": "gone"}, 1, "gone"),
        (kubeconfig(cluster="gone"), 1, "gone"),
        (kubeconfig(), 1, "the cluster of context 'here' does not answer"),
    ],
)
def test_a_kubeconfig_that_leads_nowhere(bare_desk: Desk, content: Any, code: int, text: str) -> None:
    body = content if isinstance(content, str) else yaml.safe_dump(content)
    (bare_desk.folder / "kubeconfig").write_text(body)
    said = bare_desk.type("status")
    assert (said.code, said.out) == (code, "")
    assert text in said.text
    assert "Traceback" not in said.text


def test_an_unknown_context_is_wrong_input(bare_desk: Desk) -> None:
    (bare_desk.folder / "kubeconfig").write_text(yaml.safe_dump(kubeconfig()))
    said = bare_desk.type("status", "--context", "hare")
    assert said.code == 2
    assert "--context: unknown context 'hare'; did you mean 'here'?" in said.text


def test_wrong_files_are_told_before_any_cluster_is_asked(bare_desk: Desk) -> None:
    wrong = sweep()
    wrong["spec"]["paralelism"] = 2
    said = bare_desk.type("submit", bare_desk.write(algorithm(), wrong))
    assert said.code == 2
    assert "study.yaml:" in said.text
    assert "unknown field 'paralelism'; did you mean 'parallelism'?" in said.text


def test_a_cluster_without_our_kinds(desk: Desk, crds: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.kube.user.connecting.VERSION", "v0")
    said = desk.type("status")
    assert said.code == 1
    assert "does not know Algorithm, Dataset, Evaluation, MappingRun, Sweep of slamhive.io/v0" in said.text


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_a_user_without_rights(desk: Desk, crds: Cluster, namespace: str, words: tuple[str, ...]) -> None:
    all_objects(desk)
    crds.kubectl("create", "serviceaccount", "nobody", "-n", namespace)
    token = crds.kubectl("create", "token", "nobody", "-n", namespace).strip()
    path = desk.folder / "kubeconfig"
    config = yaml.safe_load(path.read_text())
    config["users"] = [{"name": user["name"], "user": {"token": token}} for user in config["users"]]
    path.write_text(yaml.safe_dump(config))
    said = desk.type(*words)
    assert (said.code, said.out) == (1, "")
    assert "is forbidden" in said.text
    assert "Traceback" not in said.text


def test_a_namespace_that_is_not_there(desk: Desk, crds: Cluster) -> None:
    said = desk.type("submit", desk.write(algorithm()), "-n", "nowhere")
    assert said.code == 1
    assert 'namespaces "nowhere" not found' in said.text


def test_without_the_client_for_kubernetes_it_is_said_how_to_have_it() -> None:
    code = (
        "import sys; sys.modules['kubernetes'] = None; sys.argv = ['slamhive', 'status'];"
        "from slamhive.cli.main import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert how_to_install("cluster") in " ".join(done.stderr.split())


def test_the_command_does_not_import_the_client_until_it_is_needed() -> None:
    code = "import slamhive.cli.main, sys; print([m for m in sys.modules if m in {'kubernetes', 'aiohttp'}])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_what_users_import_needs_nothing_of_the_operator() -> None:
    code = (
        "import slamhive.cli.cluster.run, slamhive.cli.cluster.status, sys;"
        "print([m for m in sys.modules if m in {'kopf', 'prometheus_client'}])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("words", "code"), [(("run", "study.yaml", "--on", "cluster"), 130), (("status", "study", "--watch"), 0)]
)
def test_ctrl_c_leaves_the_sweep_running_and_says_so(
    make_lab: Callable[..., Lab], desk: Desk, words: tuple[str, ...], code: int
) -> None:
    lab = make_lab(hold=True)
    desk.write(sweep())
    if words[0] == "status":
        lab.apply(sweep())
    command = [str(Path(sys.executable).with_name("slamhive")), *words]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, cwd=desk.folder, env=dict(os.environ), **pipes)
    stream = process.stderr if words[0] == "run" else process.stdout
    assert stream is not None
    begun = stream.readline()
    while "Sweep study" not in begun:
        begun = stream.readline()
        assert begun
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == code
    assert "Traceback" not in err
    assert (words[0] == "status") or "the cluster goes on with study" in err
    body = lab.cluster.get("sweep", "study", "-n", lab.namespace)
    assert not body["spec"]["suspend"], json.dumps(body)
