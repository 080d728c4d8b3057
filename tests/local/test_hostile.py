# SPDX-License-Identifier: Apache-2.0
"""Algorithms that write where they should not, or what nobody expects, end no other run."""

from __future__ import annotations

import bz2
import gzip
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.engine import PointState
from slamhive.local.attempt import Attempt
from slamhive.model.results import Reason
from slamhive.monitor.trajectory import check_trajectory

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.data.preparation import Variant
    from slamhive.local.home import Home
    from slamhive.local.workbench import Workbench
    from slamhive.model.algorithm import Algorithm

_HEAD = """
import os, pathlib, shutil, sys
run = pathlib.Path(os.environ["SLAMHIVE_RUN"])
output = run / "output"
shutil.copyfile(run / "assets" / "truth.txt", output / "trajectory.txt")
if "act: crash" not in (run / "config.yaml").read_text():
    sys.exit(0)
"""
HOSTILE = {
    "a folder where the samples go": '(output / "usage.csv").mkdir()',
    "deep numbers": '(output / "metrics.json").write_text(\'{"a":\' * 700 + "1" + "}" * 700)',
    "deep list": '(output / "metrics.json").write_text("[" * 100000)',
    "surrogates": '(output / "metrics.json").write_text(\'{"a\\\\ud800": "\\\\ud800\\\\u0000"}\')',
    "output is a link": 'shutil.rmtree(output); output.symlink_to("/etc")',
    "no folder at all": "os.chdir('/'); shutil.rmtree(run.parent)",
    "a folder as summary": '(run.parent / "summary.json").mkdir()',
    "a folder as process record": 'record = run.parent / "process.json"; record.unlink(); record.mkdir()',
}

LEFT_BEHIND = {
    "folders 1,500 deep": """
place = os.open(output, os.O_RDONLY)
for _ in range(1500):
    os.mkdir("d", dir_fd=place)
    below = os.open("d", os.O_RDONLY, dir_fd=place)
    os.close(place)
    place = below
""",
    "locked folders": """
(output / "locked" / "inner").mkdir(parents=True)
(output / "locked").chmod(0)
output.chmod(0)
""",
}


@pytest.mark.parametrize("what", HOSTILE)
def test_what_an_algorithm_writes_ends_no_other_run(what: str, run_acts: Callable, home: Home) -> None:
    (home.path / "algorithms/actor/adapter.py").write_text(_HEAD + HOSTILE[what] + "\n")
    for rerun in (False, True):
        job, _ = run_acts(["crash", "good"], template={"retries": 0}, rerun=rerun)
        assert job.states[1] == PointState.SUCCEEDED
        assert job.states[0] in {PointState.SUCCEEDED, PointState.FAILED}


def test_an_error_nobody_foresaw_ends_its_run_alone(
    run_acts: Callable, bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepare = bench.prepare

    def fail(spec: dict[str, Any], algorithm: Algorithm) -> Variant:
        if spec["parameters"]["act"] == "crash":
            raise ZeroDivisionError("no such number")
        return prepare(spec, algorithm)

    monkeypatch.setattr(bench, "prepare", fail)
    job, notes = run_acts(["crash", "good"])
    assert list(job.states) == [PointState.FAILED, PointState.SUCCEEDED]
    broken = next(record for record in notes.records if record.index == 0)
    assert broken.reason is Reason.SYSTEM_FAULT
    assert "ZeroDivisionError: no such number" in broken.message


@pytest.mark.parametrize("what", LEFT_BEHIND)
def test_a_run_can_be_run_again_whatever_folders_it_left(what: str, run_acts: Callable, home: Home) -> None:
    adapter = home.path / "algorithms/actor/adapter.py"
    adapter.write_text(_HEAD + LEFT_BEHIND[what] + "\n")
    run_acts(["crash"], template={"retries": 0})
    adapter.write_text(_HEAD)
    job, notes = run_acts(["crash"], template={"retries": 0}, rerun=True)
    assert list(job.states) == [PointState.SUCCEEDED], notes.records[-1].message


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
def test_a_compressed_trajectory_is_refused_as_on_a_cluster(pack: Callable, tmp_path: Path) -> None:
    """Unpacking it is not even begun: it may become gigabytes."""
    text = b"".join(b"%d 0 0 0 0 0 0 1\n" % k for k in range(100))
    output = tmp_path / "run" / "output"
    output.mkdir(parents=True)
    (output / "trajectory.txt").write_bytes(pack(text))
    attempt = Attempt(tmp_path)
    (tmp_path / "summary.json").write_text('{"exitCode": 0}')
    assert attempt.trajectory() is None
    problem = "output/trajectory.txt is compressed; it must be plain text"
    assert attempt.end().trajectory_problem == problem
    assert check_trajectory(str(output)).problem == problem


def test_compressed_segments_are_refused_as_on_a_cluster(run_acts: Callable, home: Home) -> None:
    segments = '(output / "segments.csv").write_bytes(__import__("gzip").compress(b"start,end\\n"))'
    (home.path / "algorithms/actor/adapter.py").write_text(f"{_HEAD.replace('crash', 'good')}{segments}\n")
    _, notes = run_acts(["good"], template={"retries": 0})
    assert "output/segments.csv is compressed; it must be plain text" in str(notes.records[0].message)
