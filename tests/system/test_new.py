# SPDX-License-Identifier: Apache-2.0
"""``slamhive new`` and ``slamhive schema``: what they write can be used as it is."""

from __future__ import annotations

import json
import os
import pty
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.cli.parts.checked import check_files
from slamhive.local.home.catalog import load_workshop

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture
def new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: Callable[..., Any]
) -> Callable[..., Any]:
    """Calls the command in this process, in an empty folder and home."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))

    return run_command


def test_a_sweep_without_a_terminal_takes_what_is_usual(new: Callable[..., Any], tmp_path: Path) -> None:
    code, out, err = new("new", "sweep", "study", "--vary", "maxRange=30,100", "--vary", "input.frameRate=5")
    assert (code, err) == (0, "")
    assert "wrote study.yaml: 6 runs" in out
    checked = check_files([tmp_path / "study.yaml"], load_workshop())
    assert checked.problems == []
    assert len(checked.plans[0][1]) == 6
    text = (tmp_path / "study.yaml").read_text()
    place = text.splitlines()[0].removeprefix("# yaml-language-server: $schema=")
    assert json.loads(Path(place).read_text(encoding="utf-8"))["title"] == "Sweep"
    assert yaml.safe_load(text)["spec"]["template"]["spec"] == {
        "algorithmRef": {"name": "kiss-icp"},
        "datasetRef": {"name": "synthetic-lidar"},
    }


def test_nothing_is_overwritten(new: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_text("mine")
    for words in (("sweep", "study"), ("dataset", "study")):
        code, _, err = new("new", *words)
        assert code == 2
        assert "study.yaml is there already; nothing is overwritten" in err
    assert (tmp_path / "study.yaml").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["study.yaml"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-a", "kiss-icq"], "unknown algorithm 'kiss-icq'; did you mean 'kiss-icp'?"),
        (["-d", "synthetic-lidar,synthetic-lidar"], "dataset 'synthetic-lidar' stands twice"),
        (["--vary", "maxRange"], "--vary: expected FIELD=VALUE,VALUE, found 'maxRange'"),
        (["--vary", "maxRang=1"], "'maxRang' is no field"),
        (["--vary", "maxRange=0.5"], "0.5 is below the minimum"),
        (["-a", "orb-slam3-smallvoc", "-d", "synthetic-lidar"], "have no sensor mode in common"),
        (
            ["-a", "orb-slam3-smallvoc", "-d", "synthetic-camera", "--sensors", "lidar"],
            "unknown sensor mode 'lidar'",
        ),
    ],
)
def test_a_wrong_answer_is_one_sentence_and_no_file(
    words: list[str], message: str, new: Callable[..., Any], tmp_path: Path
) -> None:
    code, out, err = new("new", "sweep", *words)
    assert (code, out) == (2, "")
    assert message in err
    assert len(err.splitlines()) == 1
    assert not [path for path in tmp_path.iterdir() if path.name != "home"]


def test_a_generated_dataset_can_be_added(new: Callable[..., Any], tmp_path: Path) -> None:
    assert new("new", "dataset", "hall", "--sensors", "Lidar", "--duration", "8s")[0] == 0
    assert new("dataset", "add", "hall.yaml")[0] == 0
    code, _, _ = new("new", "sweep")
    assert code == 0
    spec = yaml.safe_load((tmp_path / "study.yaml").read_text())["spec"]
    assert spec["template"]["spec"]["datasetRef"] == {"name": "hall"}
    assert "durationSeconds" in new("new", "dataset", "b", "--duration", "2s")[2]


def test_an_algorithm_is_begun(new: Callable[..., Any], tmp_path: Path) -> None:
    assert new("new", "algorithm", "mine")[0] == 0
    text = (tmp_path / "mine" / "algorithm.yaml").read_text()
    assert text.count("# yaml-language-server: $schema=/") == 1
    assert "default: my-slam" not in text


def test_questions_are_asked_where_there_is_a_terminal(
    new: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = pty.openpty()
    answers = ["asked", "nothing,kiss-icp", "kiss-icp", "", "maxRange=30,100", "", "zero", "2"]
    os.write(ours, "".join(f"{one}\n" for one in answers).encode())
    with os.fdopen(theirs, "r", encoding="utf-8") as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        code, out, err = new("new", "sweep")
    os.close(ours)
    assert code == 0, err
    assert "unknown algorithm 'nothing'" in err
    assert "expected a whole number" in err
    assert "wrote asked.yaml: 4 runs" in out


def test_schemas_are_printed_and_written(new: Callable[..., Any], tmp_path: Path) -> None:
    code, out, _ = new("schema", "sweep")
    assert (code, json.loads(out)["title"]) == (0, "Sweep")
    code, out, _ = new("schema", "-o", "made")
    assert code == 0
    assert len(list((tmp_path / "made").iterdir())) == 6
    assert "# yaml-language-server: $schema=" in out
    code, _, err = new("schema", "sweeps")
    assert (code, err.strip()) == (2, "error: KIND: unknown kind 'sweeps'; did you mean 'Sweep'?")
