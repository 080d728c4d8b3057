# SPDX-License-Identifier: Apache-2.0
"""``slamhive results`` on little, on nothing, and with wrong input."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Command = Callable[..., Any]


@pytest.fixture
def filled(tmp_path: Path, take: Command, show: Command, make_run: Callable[..., Path]) -> Command:
    make_run("001")
    make_run("002", trajectory="")
    make_run("003", algorithm="new|[red]-ros-mono")
    take("slam-hive", tmp_path / "runs", "--ground-truth", tmp_path / "truth")
    return show


@pytest.mark.parametrize("words", [("list",), ("table",), ("export",), ("export", "--format", "json")])
def test_an_empty_archive(show: Command, words: tuple[str, ...]) -> None:
    outcome = show(*words)
    assert outcome.exit_code == 0
    if "json" in words:
        assert json.loads(outcome.stdout) == []


@pytest.mark.parametrize(
    ("form", "empty"), [("table", ""), ("markdown", "| node | kind |"), ("csv", ""), ("json", "[]")]
)
def test_runs_without_a_node_have_none_to_compare(filled: Command, form: str, empty: str) -> None:
    outcome = filled("nodes", "--format", form)
    assert outcome.exit_code == 0
    assert outcome.stdout.strip().startswith(empty)
    assert "of no run both node and CPU time are known" in outcome.stderr


def test_failures_stand_beside_the_means(filled: Command) -> None:
    lines = filled("table", "--format", "markdown").stdout.splitlines()
    assert any(
        line.startswith("| orb-slam2 |") and line.endswith("| 0.500 ± 0.707 | 1 | 1 NoTrajectory |")
        for line in lines
    )


def test_names_are_never_markup(filled: Command) -> None:
    assert "new-red" in filled("list").stdout
    row = json.loads(filled("show", "3", "--json").stdout)[0]
    assert row["label.algorithm"] == "new|[red]-ros-mono"
    assert "new|[red]-ros-mono" in filled("show", "3").stdout
    assert "new\\|[red]-ros-mono" in filled("export", "--format", "markdown").stdout


def test_nothing_is_cut_off_without_a_terminal(filled: Command) -> None:
    text = filled("list", "--columns", "uid,name,ate.rmse,label.algorithm,folder,message").stdout
    uid = json.loads(filled("show", "1", "--json").stdout)[0]["uid"]
    assert uid in text
    assert "…" not in text


def test_writing_to_a_file(filled: Command, tmp_path: Path) -> None:
    file = tmp_path / "out.json"
    assert filled("export", "--format", "json", "-o", file).stdout == ""
    assert len(json.loads(file.read_text())) == 3


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("list", "--where", "ate.rms < 1"), "unknown column 'ate.rms'; did you mean 'ate.rmse'"),
        (("list", "--sweep", "slamhive"), "--sweep: unknown sweep 'slamhive'; did you mean 'slam-hive'"),
        (("table", "--evaluation", "sim"), "--evaluation: unknown evaluation 'sim'; did you mean 'sim3'"),
        (("table", "-m", "ate.rmsee"), "unknown column 'ate.rmsee'; did you mean 'ate.rmse'"),
        (("table", "-m", "ate.rmse:furlong"), "'furlong' is neither a unit of ate.rmse"),
        (("table", "--rows", "datset"), "unknown column 'datset'; did you mean 'dataset'"),
        (("table", "--columns", "ate.rmse"), "--columns: ate.rmse is a result"),
        (("table", "--sort", "x"), "unknown column 'x'"),
        (("list", "--sort", "-x"), "unknown column 'x'"),
        (("show", "nobody"), "unknown run 'nobody'"),
        (("export", "--format", "table"), "export writes csv, json or markdown"),
        (("export", "-o", "/nowhere/x"), "--output: /nowhere/x: No such file"),
    ],
)
@pytest.mark.usefixtures("filled")
def test_wrong_input_is_a_sentence(
    run_command: Callable[..., tuple[int, str, str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    problem: str,
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    code, _, said = run_command("results", *words)
    assert code == 2
    assert problem in said


@pytest.mark.parametrize("name", ["list", "show", "table", "export"])
def test_help_has_an_example(show: Command, name: str) -> None:
    assert f"Example: slamhive results {name}" in show(name, "--help").stdout
