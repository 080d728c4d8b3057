# SPDX-License-Identifier: Apache-2.0
"""`slamhive run` as people and scripts meet it: cores, exit codes, options, and who has to wait."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
import yaml

from slamhive.local.programs.cores import whole_cores
from slamhive.model.results import Phase

pytestmark = pytest.mark.timeout(300)

CORES = len(whole_cores())


def axis(*numbers: int) -> list[dict[str, Any]]:
    return [{"path": "parameters.number", "values": list(numbers)}]


def acts(*names: str) -> list[dict[str, Any]]:
    return [{"path": "parameters.act", "values": list(names)}]


def spans(system: Any) -> list[tuple[float, float, set[int]]]:
    """Return start, end and processors of each attempt that the actors noted."""
    begun, found = {}, []
    for entry in system.journal():
        if entry["event"] == "start":
            begun[entry["run"]] = entry
        else:
            start = begun.pop(entry["run"])
            found.append((start["time"], entry["time"], set(start["cpus"])))
    return found


def overlapping(system: Any) -> list[tuple[set[int], set[int]]]:
    """Return the processors of each two attempts that ran at the same time."""
    pairs = combinations(spans(system), 2)
    return [(one[2], two[2]) for one, two in pairs if one[0] < two[1] and two[0] < one[1]]


def test_the_documented_lines_start_a_run_s_program_by_hand(system: Any, tmp_path: Path) -> None:
    assert system("run", system.sweep())[0] == 0
    document = (Path(__file__).parents[2] / "docs" / "algorithms.md").read_text()
    lines = document.partition("### By hand")[2].split("```")[1].removeprefix("text\n")
    (run,) = (system.home.path / "runs" / "s").iterdir()
    before = (run / "run" / "output" / "trajectory.txt").read_text()
    done = subprocess.run(
        ["bash", "-ec", lines], cwd=tmp_path, env=os.environ | {"RUN": str(run)}, check=False
    )
    assert done.returncode == 0
    assert (tmp_path / "try" / "output" / "trajectory.txt").read_text() == before


@pytest.mark.skipif(CORES < 2, reason="needs two cores")
def test_parallel_runs_share_no_core(system: Any) -> None:
    code, _, err = system("run", system.sweep(matrix=axis(*range(400, 408))))
    assert code == 0, err
    together = overlapping(system)
    assert together
    assert not any(one & two for one, two in together)


def test_one_job_runs_one_at_a_time(system: Any) -> None:
    code, _, err = system("run", "-j", "1", system.sweep(matrix=axis(*range(50, 54))))
    assert code == 0, err
    assert len(spans(system)) == 4
    assert not overlapping(system)


def test_a_run_that_asks_for_more_cores_than_there_are_gets_all(system: Any) -> None:
    sweep = system.sweep(template={"resources": {"cpu": "1000"}}, repetitions=2)
    code, _, err = system("run", sweep)
    assert code == 0, err
    everything = sorted(os.sched_getaffinity(0))
    for entry in system.journal("start"):
        assert entry["cpus"] == everything
        assert entry["threads"] == str(len(everything))
    assert not overlapping(system)


def test_what_has_to_be_alone_is_refused_beside_a_runner(system: Any, until: Any) -> None:
    first = system.fork("run", system.sweep(matrix=axis(60_000)))
    until(lambda: system.journal("start"), "the first run's start")
    code, out, err = system("sweep", "rename", "s", "other")
    assert (code, out) == (2, "")
    assert f"slamhive run (process {first.pid}, since" in err
    assert "is at work in" in err
    first.send_signal(signal.SIGINT)
    assert first.wait(120) == 130
    said = system.printed(first)[0]
    assert "1 not run" in said
    assert "results table" not in said  # which would end with: unknown sweep


def test_failures_are_told_and_give_exit_code_1(system: Any) -> None:
    code, out, err = system("run", system.sweep(matrix=acts("crash", "good")))
    assert code == 1
    assert "1 succeeded, 1 failed" in out
    assert "AlgorithmFailed" in err
    assert "cannot open the map" in err
    assert "Traceback" not in out + err


def test_finished_runs_are_done_again_only_when_asked(system: Any) -> None:
    sweep = system.sweep(matrix=axis(1, 2))
    for arguments, attempts in (((), 2), ((), 2), (("--rerun",), 4), (("--retry-failed",), 4)):
        code, _, err = system("run", sweep, *arguments)
        assert code == 0, err
        assert len(system.journal("start")) == attempts
    assert len(system.records()) == 2


def test_failed_runs_are_done_again_only_when_asked(system: Any) -> None:
    sweep = system.sweep(matrix=acts("crash", "noted"))

    def times() -> dict[Any, Any]:
        return {record.spec["parameters"]["act"]: record.started for record in system.records()}

    assert system("run", sweep)[0] == 1
    first = times()
    code, out, _ = system("run", sweep)
    assert (code, times()) == (1, first)
    assert "2 done before" in out
    assert system("run", sweep, "--retry-failed")[0] == 1
    assert times()["noted"] == first["noted"]
    assert times()["crash"] > first["crash"]


def test_watch_runs_what_a_changed_file_adds(system: Any, until: Any) -> None:
    process = system.fork("run", "--watch", system.sweep(matrix=axis(1, 2)))

    def printed(words: str, times: int) -> bool:
        assert process.poll() is None, system.printed(process)[1]
        return system.printed(process)[1].count(words) >= times

    until(lambda: printed("watching", 1), "the first round")
    (system.folder / "s.yaml").write_text("kind: [")
    until(lambda: printed("error:", 1) and printed("watching", 2), "a sentence about the broken file")
    system.sweep(matrix=axis(1, 2, 3))
    until(lambda: printed("watching", 3), "the second round")
    process.send_signal(signal.SIGINT)
    assert process.wait(120) == 0
    assert len(system.journal("start")) == 3
    numbers = sorted(record.spec["parameters"]["number"] for record in system.records())
    assert numbers == [1, 2, 3]


def test_an_edited_sweep_shows_its_own_runs_alone(system: Any) -> None:
    assert system("run", system.sweep(matrix=axis(1, 2, 3)))[0] == 0
    code, out, err = system("run", system.sweep(matrix=axis(3, 4)))
    assert code == 0, err
    assert "2 runs: 2 succeeded" in out
    assert "1 reused" in out
    assert sorted(record.spec["parameters"]["number"] for record in system.records()) == [3, 4]
    assert exported(system) == [3, 4]
    assert exported(system, "--superseded") == [1, 2, 3, 4]
    assert exported(system, "--superseded", "--reused") == [1, 2, 3, 3, 4]
    code, _, err = system("results", "table")
    assert code == 0
    assert "3 runs of earlier versions left out (sweep edited); --superseded shows them" in err


def exported(system: Any, *words: str) -> list[int]:
    """Return the numbers of the runs that are exported."""
    code, text, _ = system("results", "export", "--format", "json", *words)
    assert code == 0
    return sorted(row["parameters.number"] for row in json.loads(text))


def test_a_single_run_is_a_sweep_of_one(system: Any) -> None:
    spec = {"algorithmRef": {"name": "actor"}, "datasetRef": {"name": "tiny"}}
    code, out, err = system("run", system.manifest("MappingRun", "single", spec))
    assert code == 0, err
    assert "1 run: 1 succeeded" in out
    assert [record.phase for record in system.records("single")] == [Phase.SUCCEEDED]


def test_an_evaluation_measures_archived_runs_under_its_name(system: Any) -> None:
    sweep = system.sweep(matrix=acts("good", "half", "crash"))
    assert system("run", sweep)[0] == 1
    spec = {"runs": {"sweepRef": {"name": "s"}}, "alignment": "Sim3", "success": {"minCoverage": 0.5}}
    code, out, err = system("run", system.manifest("Evaluation", "lenient", spec))
    assert "lenient: 2 runs evaluated" in out
    assert "AlgorithmFailed" in err or "no trajectory" in err
    assert code == 0
    code, text, _ = system("results", "export", "--sweep", "s", "--format", "json")
    assert code == 0
    rows = [row for row in json.loads(text) if row.get("evaluation")]
    outcomes = {(row["parameters.act"], row["evaluation"]): row["outcome"] for row in rows}
    assert outcomes == {
        ("good", "se3"): "Tracked",
        ("half", "se3"): "Partial",
        ("good", "lenient"): "Tracked",
        ("half", "lenient"): "Tracked",
        ("crash", "se3"): None,
        ("crash", "lenient"): None,
    }


def test_other_settings_measure_again_without_running_again(system: Any) -> None:
    assert system("run", system.sweep(repetitions=2))[0] == 0
    code, _, err = system("run", system.sweep(repetitions=2, evaluation={"alignment": "Origin"}))
    assert code == 0, err
    assert len(system.journal("start")) == 2
    assert {result.evaluation for record in system.records() for result in record.results} == {
        "se3",
        "origin",
    }


def test_several_kinds_in_one_file(system: Any) -> None:
    path = system.sweep()
    dataset = yaml.safe_load((system.home.path / "tiny.yaml").read_text())
    dataset["metadata"]["name"] = "other"
    path.write_text(yaml.safe_dump(dataset) + "---\n" + path.read_text().replace("name: tiny", "name: other"))
    code, _, err = system("run", path)
    assert code == 0, err
    assert system.records()[0].spec["datasetRef"] == {"name": "other"}
