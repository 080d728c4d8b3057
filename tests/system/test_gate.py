# SPDX-License-Identifier: Apache-2.0
"""`slamhive gate` on real runs of a small algorithm, and the shell steps of its Action and its template."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from slamhive.reporting.gate.baseline import Baseline, BaselineCell, read_baseline

GATE = Path(__file__).parents[2] / "tools" / "gate"
AXIS = [{"path": "parameters.number", "values": [1, 2]}]


@pytest.fixture
def recorded(system: Any) -> Path:
    """A baseline of two settings that ran twice each."""
    sweep = system.sweep("s", {"parameters": {}}, matrix=AXIS, repetitions=2)
    code, said, problems = system("gate", sweep, "--record", "base.json")
    assert code == 0, problems
    assert "base.json: 2 settings, 2 runs each, 0 not tracked" in said
    assert all("disturbed" in cell.values for cell in read_baseline(system.folder / "base.json").cells)
    return system.folder / "base.json"


def write_baseline(path: Path, *numbers: int) -> Path:
    """Write a baseline of settings that no run was needed for."""
    cells = [
        BaselineCell(
            sweep="s",
            settings={"parameters.number": number},
            dataset="tiny",
            tracked=[True, True],
            values={"ate.rmse": [0.0, 0.0], "usage.cpu.secondsPerDataSecond": [0.1, 0.1]},
        )
        for number in numbers
    ]
    Baseline(processor="Z80", cells=cells).write(path)
    return path


@pytest.fixture
def written(system: Any) -> Path:
    """A baseline of the same that no run was needed for."""
    write_baseline(system.folder / "base.json", 1, 2)
    system.sweep("s", {"parameters": {}}, matrix=AXIS)
    return system.folder / "base.json"


def test_unchanged_is_no_worse_by_few_runs_and_goes_on_where_it_was(system: Any, recorded: Path) -> None:
    sweep = system.folder / "s.yaml"
    words = ("gate", sweep, "--baseline", recorded, "--figure", "ate")
    code, said, problems = system(*words, "--rerun")
    assert code == 0, problems
    assert "s: no worse (2 runs against base.json; sure after 1 look)" in said
    # With failures too: four runs are too few to know that no more fail.
    code, said, problems = system("gate", sweep, "--baseline", recorded, "--figure", "failures")
    assert code == 3, problems
    assert "can't tell: runs not tracked" in said


def test_a_gate_that_does_runs_again_goes_on_when_it_was_interrupted(system: Any, until: Any) -> None:
    numbers = [700, 701]  # ms, so that there is time to interrupt the second
    sweep = system.sweep("s", matrix=[{"path": "parameters.number", "values": numbers}])
    baseline = write_baseline(system.folder / "base.json", *numbers)
    words = ("gate", sweep, "--baseline", baseline, "--figure", "ate", "--rerun", "-j", "1")

    process = system.start(*words)
    until(lambda: len(system.journal("start")) == 2, "the second run")
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 130
    assert "the same command goes on from here" in system.printed(process)[1]

    code, said, problems = system(*words)
    assert code == 0, problems
    assert "s: no worse (2 runs against base.json" in said
    assert "goes on with what was interrupted: 1 run since" in problems
    assert len(system.journal("start")) == 3

    code, _, problems = system(*words)  # one that ended is done again, all of it
    assert code == 0, problems
    assert "goes on" not in problems
    assert len(system.journal("start")) == 5


def test_what_fails_now_is_worse_and_the_files_say_so(system: Any, recorded: Path) -> None:
    sweep = system.sweep("s", {"parameters": {"act": "crash"}}, matrix=AXIS)
    files = ("--summary", "gate.md", "--junit", "gate.xml", "--repetitions", "6")
    code, said, problems = system("gate", sweep, "--baseline", recorded, *files, "--figure", "failures")
    assert code == 4, problems
    assert "s: worse: runs not tracked" in said
    assert "### 🔴 s: worse" in (system.folder / "gate.md").read_text()
    assert (
        '<failure message="figure: runs not tracked; answer: worse'
        in (system.folder / "gate.xml").read_text()
    )


def test_another_processor_leaves_load_out_and_one_repetition_says_what_it_hides(
    system: Any, written: Path
) -> None:
    known = read_baseline(written)
    alone = [
        cell.replace(tracked=cell.tracked[:1], values={name: of[:1] for name, of in cell.values.items()})
        for cell in known.cells
    ]
    known.replace(cells=alone).write(written)
    _, said, problems = system("gate", "s.yaml", "--baseline", written, "--repetitions", "1")
    assert "CPU" not in said
    assert "not compared: CPU time per second of data" in problems
    assert "recorded on Z80" in problems
    assert "all settings of the baseline ran once" in problems


def test_the_wall_time_of_what_has_no_latency_is_looked_at_beside_nodes(system: Any, written: Path) -> None:
    node, other = read_baseline(written).cells
    node = node.replace(values=node.values | {"metrics.latencySeconds.median": [0.1, 0.1]})
    cells = [
        cell.replace(values=cell.values | {"usage.undisturbedSeconds": [1.0, 1.0]}) for cell in (node, other)
    ]
    read_baseline(written).replace(cells=cells).write(written)
    _, _, problems = system("gate", "s.yaml", "--baseline", written, "--repetitions", "1")
    assert "latency p50, undisturbed wall time: recorded on Z80" in problems


def test_a_baseline_of_another_part_of_the_recording_is_refused(system: Any, recorded: Path) -> None:
    sweep = system.sweep("s", {"parameters": {}, "input": {"duration": "5s"}}, matrix=AXIS)
    code, _, problems = system("gate", sweep, "--baseline", recorded)
    assert code == 2
    assert 'base.json: number 1: input.duration: recorded with none, here "5s"' in problems


def test_what_cannot_be_compared_is_refused(system: Any, written: Path) -> None:
    other = system.sweep("s", {"parameters": {}}, matrix=[{"path": "parameters.number", "values": [3]}])
    for words, told in (
        (
            (other, "--baseline", written),
            "tiny parameters.number 1; tiny parameters.number 2; the sweep has tiny parameters.number 3",
        ),
        ((other,), "give one of --baseline FILE, to compare, and --record FILE"),
        ((other, "--record", "no/base.json"), "its folder isn't there"),
        ((other, "--baseline", written, "--tier", "smoke"), "none here has a label tier"),
        ((other, "--baseline", written, "--margin", "cpu"), "expected NAME=MARGIN"),
        ((other, "--baseline", written, "--budget", "soon"), "expected a duration"),
        ((other, "--baseline", "none.json"), "none.json: No such file"),
    ):
        code, _, problems = system("gate", *words)
        assert (code, told in problems) == (2, True), problems
    cells = [cell.replace(dataset_sha256="0" * 64) for cell in read_baseline(written).cells]
    read_baseline(written).replace(cells=cells).write(written)
    same = system.sweep("s", {"parameters": {}}, matrix=AXIS)
    code, _, problems = system("gate", same, "--baseline", written)
    assert (code, "dataset tiny: recorded with 0000" in problems) == (2, True), problems


def steps(system: Any, script: str, variables: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a script as runners do."""
    programs = system.folder / "bin"
    programs.mkdir(exist_ok=True)
    ours = f"#!/bin/sh\nexec {sys.executable} -c 'from slamhive.cli.main import main; main()' \"$@\"\n"
    told = '#!/bin/sh\necho "$@" > "$RUNNER_TEMP/told"\n'
    for name, text in (("slamhive", ours), ("gh", told)):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    path = f"{programs}:{os.environ['PATH']}"
    place = {"PATH": path, "SLAMHIVE_HOME": str(system.home.path), "RUNNER_TEMP": str(system.folder)}
    return subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", script],
        cwd=system.folder,
        env=os.environ | place | variables,
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_steps_of_the_action_record_first_and_compare_then(system: Any) -> None:
    system.sweep("s", {"parameters": {}}, matrix=AXIS, repetitions=2)
    action = yaml.safe_load((GATE / "action.yml").read_text())
    scripts = {step["id"]: step["run"] for step in action["runs"]["steps"] if "run" in step}
    files = {name: str(system.folder / name) for name in ("GITHUB_STEP_SUMMARY", "GITHUB_OUTPUT")}
    given = files | {
        "FILES": "s.yaml",
        "BASELINE": "base.json",
        "BUDGET": "10m",
        "TIER": "",
        "UNKNOWN": "fail",
    }
    assert steps(system, scripts["install"], given).returncode == 0
    first = steps(system, scripts["gate"], given | {"OPTIONS": "--figure ate"})
    assert first.returncode == 0, first.stderr
    assert "not there yet: it is recorded now" in first.stderr
    assert "no baseline yet, so nothing was compared" in Path(files["GITHUB_STEP_SUMMARY"]).read_text()
    then = steps(system, scripts["gate"], given | {"OPTIONS": "--figure ate --figure failures"})
    assert then.returncode == 3, then.stderr
    assert Path(files["GITHUB_OUTPUT"]).read_text() == "code=0\ncode=3\n"
    assert steps(system, scripts["comment"], {"NUMBER": "7"}).returncode == 0
    body = system.folder / "gate.md"
    assert (system.folder / "told").read_text().startswith(f"pr comment 7 --body-file {body}")
    assert "can't tell: runs not tracked" in body.read_text()


def test_the_script_of_the_gitlab_template_runs(system: Any, written: Path) -> None:
    job = yaml.safe_load((GATE / "gitlab.yml").read_text())[".slamhive-gate"]
    given = job["variables"] | {
        "GATE_FILES": "s.yaml",
        "GATE_BASELINE": written.name,
        "GATE_OPTIONS": "--figure ate --log-format json",
    }
    done = steps(system, "\n".join(job["script"]), given)
    assert done.returncode == 0, done.stderr
    last = [json.loads(line) for line in done.stdout.splitlines()]
    assert [one["answer"] for one in last if one["event"] == "answer"] == ["no worse"]
    assert (system.folder / "gate.xml").is_file()
