# SPDX-License-Identifier: Apache-2.0
"""Tests of whole checks: an algorithm that keeps the contract passes each row, one that breaks it doesn't."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from slamhive.archive import Archive
from slamhive.conformance import rows, workstation
from slamhive.conformance.damaging import Damage
from slamhive.conformance.executors import CheckStart
from slamhive.conformance.findings import CheckAnswer
from slamhive.conformance.workstation import OnWorkstation, bench_for_checks
from slamhive.model.sensors import Role
from slamhive.monitor.programs.orphans import ProcessRecord

from .conftest import NAME, Notes, behaving

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.conformance.findings import Finding
    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home


pytestmark = pytest.mark.timeout(300)  # six starts, on a machine that may be busy
UNTOLD = "rendered: settings.txt; this disk doesn't tell whether they were read"
"""Of a disk that is mounted without times of access."""


def test_an_algorithm_that_keeps_the_contract_passes_and_leaves_nothing(
    home: Home, check: Callable[..., dict[str, Finding]]
) -> None:
    with Archive.open(home.archive_url):
        pass
    before = {path.name for path in home.path.iterdir()}
    notes = Notes()
    found = check(set(), notes)
    assert {name: one.found for name, one in found.items() if one.answer == "fail"} == {}
    assert found["settings"].found in {"rendered and opened: settings.txt", UNTOLD}
    sound = {"parameters", "runs", "data", "accuracy", "frame", "direction", "determinism"}
    passed = {name for name, one in found.items() if one.answer is CheckAnswer.PASS}
    assert passed >= sound | {"without lidar", "no data"}
    # It reads the recording by itself and says nothing of what that took.
    assert found["time and memory"].answer is CheckAnswer.WARNING
    assert "whether the reading of the recording is in it isn't known" in found["time and memory"].found
    assert "3 runs are equal to the byte" in found["determinism"].found
    assert "the recording has no topic /points" in found["without lidar"].found
    assert "the recording has no scan on /points" in found["no data"].found
    assert {one.executor for one in found.values()} == {"", "process"}
    assert len(notes.done) == notes.steps == 6
    with Archive.open(home.archive_url, read_only=True) as archive:
        assert list(archive.runs()) == []
    assert {path.name for path in home.path.iterdir()} - before == {"variants", "truths", "assets"}


@pytest.mark.slow
def test_each_row_fails_for_what_breaks_it_with_words_that_help(
    check: Callable[..., dict[str, Finding]],
) -> None:
    breaks = {"unread", "half", "differs", "crashes"}
    parameters = {name: {"type": "Integer", "default": 1} for name in ("size", "depth")}
    found = check(breaks, parameters=parameters)
    failed = {name: one.found for name, one in found.items() if one.answer is CheckAnswer.FAIL}
    assert "names depth" in failed["parameters"]
    assert found["settings"].found in {"rendered, but nothing opened settings.txt", UNTOLD}
    assert "before the end of the data" in failed["data"]
    assert failed["determinism"].startswith("declared Yes; 3 runs differ")
    assert "it crashed" in failed["no data"]
    assert "SIGSEGV" in failed["no data"]
    assert all(one.help for one in found.values() if one.answer is CheckAnswer.FAIL)


def test_what_waits_for_a_topic_that_is_not_there_fails(
    home: Home, workshop_of: Callable[[Home], Workshop]
) -> None:
    behaving(home, {"waits"})
    with bench_for_checks(home, workshop_of(home)) as bench:
        (mode,) = bench.workshop.algorithm(NAME).algorithm.spec.modes
        start = CheckStart(mode, timeout=1.0, damage=Damage(Role.LIDAR))
        found = rows.refusal("without lidar", OnWorkstation(bench, NAME, "tiny").run(start), start.timeout)
    assert found.answer is CheckAnswer.FAIL
    assert found.found == "it still waited after 1 s"
    assert found.help.startswith("don't wait for ever")


@pytest.mark.slow
def test_poses_of_another_frame_are_told_with_what_to_declare(
    check: Callable[..., dict[str, Finding]],
) -> None:
    found = check(set(), output={"frame": "lidar"})
    assert found["frame"].answer is CheckAnswer.FAIL
    assert "output.frame: body fits better: 0.0" in found["frame"].found
    assert "times less" in found["frame"].found
    assert found["frame"].help == "declare output.frame: body"


def test_what_does_not_run_is_told_and_nothing_more_is_started(
    check: Callable[..., dict[str, Finding]],
) -> None:
    notes = Notes()
    found = check({"never"}, notes)
    assert found["runs"].answer is CheckAnswer.FAIL
    assert "the licence has run out" in found["runs"].found
    assert len(notes.done) == 1


@pytest.mark.parametrize(
    ("breaks", "answer", "words"),
    [
        ({"slow"}, CheckAnswer.PASS, "(SIGTERM); 201 poses kept"),
        ({"slow", "deaf"}, CheckAnswer.FAIL, "it did not end, and was killed"),
    ],
)
def test_what_is_told_to_end_has_to_and_what_it_wrote_stays(  # noqa: PLR0917
    breaks: set[str],
    answer: CheckAnswer,
    words: str,
    home: Home,
    workshop_of: Callable[[Home], Workshop],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    behaving(home, breaks)
    # Told to end when all poses are there, whenever that is.
    monkeypatch.setattr(workstation, "_runs", lambda folder: (folder / "run/output/begun").exists())
    with bench_for_checks(home, workshop_of(home)) as bench:
        (mode,) = bench.workshop.algorithm(NAME).algorithm.spec.modes
        ended = OnWorkstation(bench, NAME, "tiny").run(CheckStart(mode, timeout=60.0, stop_after=0.0))
    found = rows.stopped(ended)
    assert found is not None
    assert found.answer is answer
    assert words in found.found


def test_a_check_that_is_interrupted_ends_what_it_started_and_removes_what_it_made(
    home: Home, workshop_of: Callable[[Home], Workshop], monkeypatch: pytest.MonkeyPatch
) -> None:
    behaving(home, {"slow"})
    processes = []

    def begun(folder: Path) -> bool:
        if not (folder / "run/output/begun").exists():
            return False
        record = ProcessRecord.read(str(folder / "process.json"))
        assert record is not None
        assert record.algorithm is not None
        processes.extend([record.algorithm.pid, record.supervisor.pid])
        raise KeyboardInterrupt

    monkeypatch.setattr(workstation, "_runs", begun)
    with bench_for_checks(home, workshop_of(home)) as bench:
        (mode,) = bench.workshop.algorithm(NAME).algorithm.spec.modes
        with pytest.raises(KeyboardInterrupt):
            OnWorkstation(bench, NAME, "tiny").run(CheckStart(mode, timeout=60.0, stop_after=0.0))
    assert not (home.path / "check").exists()
    for pid in processes:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    assert len(processes) == 2


def test_what_a_killed_check_left_is_removed_by_the_next(
    home: Home, check: Callable[..., dict[str, Finding]]
) -> None:
    (home.path / "check" / "runs").mkdir(parents=True)
    (home.path / "check" / "datasets").symlink_to(home.path / "datasets")
    found = check({"never"})
    assert found["runs"].answer is CheckAnswer.FAIL
    assert not (home.path / "check").exists()
    assert (home.path / "datasets").exists()
