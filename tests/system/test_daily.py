# SPDX-License-Identifier: Apache-2.0
"""The daily loop: edit, run, compare; and what is told meanwhile."""

from __future__ import annotations

import json
import signal
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from slamhive.local.home.folder import Home


def axis(*values: int) -> list[dict[str, Any]]:
    return [{"path": "parameters.number", "values": list(values)}]


def edit(home: Home, text: str = "\n# changed\n") -> str:
    """Change the actor's adapter, whole or not at all, and return what it was."""
    path = home.path / "algorithms/actor/adapter.py"
    before = path.read_text()
    path.with_suffix(".new").write_text(before + text)
    path.with_suffix(".new").replace(path)
    return before


def numbers(system: Any) -> list[int]:
    return [record.spec["parameters"]["number"] for record in system.records() if "@" not in record.uid]


def test_an_edit_is_shown_before_its_runs_and_compared_after_them(system: Any, home: Home) -> None:
    sweep = system.sweep(matrix=axis(1, 2), repetitions=2)
    code, _, err = system("run", sweep)
    assert code == 0, err
    assert "s: 4 runs, all new" in err
    edit(home)
    code, out, err = system("plan", sweep, "--head", "1")
    assert "s: 4 runs of actor are stale: adapter.py changed since " in out
    # One at a time, so that they end in the order in which they begin.
    code, out, err = system("run", sweep, "-j", "1")
    assert code == 0, err
    assert "s: 4 runs of actor are stale: adapter.py changed since " in err
    ends = [line for line in err.splitlines() if line.startswith(("1/4 ", "2/4 ", "3/4 ", "4/4 "))]
    assert [line[4:28] for line in ends[:2]] == ["number 1, repetition 0: ", "number 2, repetition 0: "]
    assert all("actor" not in line and "tiny" not in line for line in ends)
    assert "(as before)" in ends[0]
    assert "Before and after: actor " in out
    assert ": adapter.py changed" in out
    assert "runs not tracked    0 of 4" in out
    code, out, err = system("run", sweep)
    assert (code, "Before and after" in out, "s: 4 runs are as before" in err) == (0, False, True)


def test_only_what_is_asked_for_is_done(system: Any) -> None:
    sweep = system.sweep(matrix=axis(1, 2, 3))
    code, out, _ = system("run", sweep, "--only", "parameters.number > 1", "--first", "1")
    assert (code, numbers(system)) == (0, [2])
    assert "1 succeeded, 0 failed, 2 left out" in out
    assert system("run", sweep, "--dataset", "tiny")[0] == 0
    assert sorted(numbers(system)) == [1, 2, 3]
    started = len(system.journal("start"))
    assert system("run", sweep, "--rerun-where", "parameters.number in (1, 3) and coverage > 0.5")[0] == 0
    assert len(system.journal("start")) == started + 2
    code, _, err = system("run", sweep, "--rerun-where", "outcome == 'Lost'")
    assert (code, len(system.journal("start"))) == (0, started + 2)
    assert "--rerun-where: no finished run of s meets it" in err


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            ("--only", "parameters.numbr > 1"),
            "--only: condition, character 1: unknown column 'parameters.numbr'; did",
        ),
        (("--only", "number > 9"), "--only: no run meets it, of 1"),
        (("--dataset", "tny"), "--dataset: the runs here: unknown dataset 'tny'"),
        (("--on", "cluster", "--only", "x"), "--on cluster: --only is for this machine alone"),
        (("--on", "cluster", "--watch", "--first", "1"), "--on cluster: --first and --watch are for this"),
    ],
)
def test_what_can_not_be_done_is_a_sentence(system: Any, options: tuple[str, ...], sentence: str) -> None:
    code, out, err = system("run", system.sweep(), *options)
    assert (code, out) == (2, "")
    assert f"error: {sentence}" in err
    assert "Traceback" not in err


def test_lines_of_json_say_all_and_nothing_else_is_printed(system: Any, home: Home) -> None:
    sweep = system.sweep(matrix=axis(1, 2))
    assert system("run", sweep)[0] == 0
    edit(home)
    code, out, err = system("run", sweep, "--log-format", "json")
    assert (code, err) == (0, "")
    lines = [json.loads(line) for line in out.splitlines()]
    assert [line["event"] for line in lines if line["event"] not in {"phase", "note"}] == [
        *("begin", "run", "run"),
        *("compared",) * sum(line["event"] == "compared" for line in lines),
        *("end", "exit"),
    ]
    begin, run = lines[0], next(line for line in lines if line["event"] == "run")
    assert (begin["stale"], begin["new"], begin["runs"]) == (2, 0, 2)
    assert run["settings"] == {"parameters.number": run["index"] + 1}
    assert run["ate"] == run["ateBefore"]
    assert {line["figure"] for line in lines if line["event"] == "compared"} >= {
        "ate.rmse",
        "runs not tracked",
    }
    assert lines[-1]["code"] == 0


def test_watch_waits_for_the_next_save_of_what_is_half_saved(system: Any, home: Home, until: Any) -> None:
    process = system.fork("run", "--watch", system.sweep())

    def printed(words: str, times: int = 1) -> bool:
        assert process.poll() is None, system.printed(process)[1]
        return system.printed(process)[1].count(words) >= times

    until(lambda: printed("watching", 1), "the first round")
    before = edit(home, "\ndef half(")
    until(lambda: printed("watching", 2), "a sentence about the adapter")
    assert printed("adapter.py, line ")
    assert len(system.journal("start")) == 1
    path = home.path / "algorithms/actor/adapter.py"
    path.with_suffix(".new").write_text(before + "\n# whole\n")
    path.with_suffix(".new").replace(path)
    until(lambda: printed("watching", 3), "the round after it was saved")
    assert printed("1 run of actor is stale: adapter.py changed since ")
    process.send_signal(signal.SIGINT)
    assert process.wait(120) == 0
    assert len(system.journal("start")) == 2


def test_a_save_while_runs_are_at_work_begins_anew(system: Any, home: Home, until: Any) -> None:
    sweep = system.sweep(template={"parameters": {"act": "hang"}, "timeout": "10m"})
    process = system.fork("run", "--watch", sweep)
    until(lambda: list((home.path / "runs").glob("*/*/process.json")), "a run at work")
    system.sweep(template={"parameters": {"act": "good"}})
    until(lambda: "watching" in system.printed(process)[1], "the round after the save")
    assert "saved while it ran: it begins again" in system.printed(process)[1]
    process.send_signal(signal.SIGINT)
    assert process.wait(120) == 0
