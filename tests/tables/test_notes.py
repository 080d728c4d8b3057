# SPDX-License-Identifier: Apache-2.0
"""``slamhive results note``: what somebody wrote of a run is shown, found and handed on with it."""

from __future__ import annotations

import csv
import io
import json
from typing import TYPE_CHECKING, Any

import pytest

import slamhive

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture
def note(run_command: Callable[..., Any]) -> Callable[..., str]:
    """``slamhive results note`` with success; returns its output, remarks too."""

    def call(*words: str) -> str:
        code, out, err = run_command("results", "note", *words)
        assert code == 0, err
        return f"{out}{err}"

    return call


@pytest.fixture
def mine(keep: Callable[[str], Any]) -> Any:
    """A home with three runs, one of them of an earlier version."""
    made = keep("mine")
    made.run("new@c0c0c0c0", name="icp-7", version="v0", content="c0")
    made.run("new", name="icp-7", version="v1", files=False)
    made.run("other", content="c2")
    return made


def test_a_note_is_found_and_shown_wherever_its_run_is(
    mine: Any, note: Callable[..., str], run_command: Callable[..., Any]
) -> None:
    said = note("icp-7", "tried robust kernel", "--tag", "robust", "--tag", "v2")
    assert "icp-7: “tried robust kernel”; tags robust, v2" in said
    assert "2 runs are called icp-7: new is the current one; by UID: new@c0c0c0c0" in " ".join(said.split())
    assert mine.records()["new@c0c0c0c0"].note is None
    assert note("s-other", "--tag", "robust-kernel") == "s-other: tag robust-kernel\n"
    assert "“tried robust kernel”" in note("new")
    assert "no note, no tags" in note("new@c0c0c0c0")

    def listed(where: str) -> list[str]:
        code, out, err = run_command(
            "results", "list", "--where", where, "--format", "json", "--columns", "uid"
        )
        assert code == 0, err
        return sorted(row["uid"] for row in json.loads(out))

    assert listed("tags contains robust") == ["new"]
    assert listed("tags contains 'robust-kernel' or note contains 'KERNEL'") == ["new", "other"]
    assert listed("tags not contains v2") == ["other"]
    assert "tried robust kernel" in run_command("results", "list")[1]
    assert "tried robust kernel" in run_command("results", "show", "new")[1]
    frame = slamhive.results()
    assert dict(zip(frame["uid"], frame["tags"], strict=True)) == {
        "new": "robust, v2",
        "other": "robust-kernel",
    }
    _, out, _ = run_command("results", "export")
    row = {row["uid"]: row for row in csv.DictReader(io.StringIO(out))}["new"]
    assert (row["note"], row["tags"]) == ("tried robust kernel", "robust, v2")


def test_a_note_replaces_the_earlier_one_and_says_so(mine: Any, note: Callable[..., str]) -> None:
    note("new", "other", "the first one", "--tag", "a,b")
    said = note("--where", "dataset == 'hall'", "the second one", "--remove-tag", "a", "--tag", "c")
    assert "icp-7: “the second one”; tags b, c" in said
    assert "icp-7: its note was “the first one”" in said
    assert "2 of 2 runs changed, of which 2 had another note" in said
    assert "0 of 2 runs changed" in note("new", "other", "--tag", "c")
    assert note("new", "--clear", "--text", "anew").startswith("icp-7: “anew”\n")
    assert {uid: (one.note, one.tags) for uid, one in mine.records().items()} == {
        "new@c0c0c0c0": (None, []),
        "new": ("anew", []),
        "other": ("the second one", ["b", "c"]),
    }


@pytest.mark.usefixtures("mine")
def test_what_can_t_be_noted_is_refused_in_a_sentence(run_command: Callable[..., Any]) -> None:
    for words, said in (
        (["s-othr", "a typing error"], "RUN: unknown run 's-othr'; did you mean 's-other'?"),
        (["new", "good"], "RUN: unknown run 'good'; known: icp-7"),
        (["new", "good"], "(a note of one word is given by --text)"),
        (["new", ""], "--text: an empty one; --clear removes"),
        (["new", "x " * 1001], "--text: has 2,002 characters, at most 2,000"),
        (["new", "--tag", "two words"], "--tag: 'two words': a tag is one word"),
        (["a note on nothing"], "say which runs: either by RUN, or by --where and --sweep"),
        (["new", "--where", "coverage > 0", "--tag", "x"], "say which runs: either by RUN"),
        (["--where", "run == 3", "--tag", "x"], "no run is meant: there is nothing to put a note on"),
        (["--sweep", "nobody", "--tag", "x"], "--sweep: unknown sweep 'nobody'"),
    ):
        code, _, err = run_command("results", "note", *words)
        assert (code, said in " ".join(err.split())) == (2, True), err


def test_a_name_of_several_current_runs_and_a_run_of_another_home_are_refused(
    mine: Any, keep: Callable[[str], Any], run_command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine.run("far", name="s-other", namespace="lab", content="c2", files=False)
    code, _, err = run_command("results", "note", "s-other", "--tag", "x")
    assert (code, "2 runs are called 's-other': name one by its UID: other, far" in err) == (2, True), err
    anna = keep("anna")
    anna.run("hers", content="c3")
    monkeypatch.setenv("SLAMHIVE_ALSO", str(anna.path))
    for name in ("s-hers", "hers~anna"):
        code, _, err = run_command("results", "note", name, "--tag", "x")
        assert (code, f"{name} is a run of another home, anna" in err) == (2, True), err
    assert anna.records()["hers"].tags == []


def test_a_merge_brings_tags_of_both_and_the_newer_note(
    mine: Any,
    keep: Callable[[str], Any],
    note: Callable[..., str],
    run_command: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    anna = keep("anna")
    for record in [mine.records()[uid] for uid in ("new", "other")]:
        anna.run(
            record.uid,
            name=record.name,
            created=record.created,
            finished=record.finished,
            content={"new": "c1", "other": "c2"}[record.uid],
            version="v1",
        )
    anna.run("hers", content="c3")
    note("new", "written first", "--tag", "mine")
    monkeypatch.setenv("SLAMHIVE_HOME", str(anna.path))
    note("new", "written later", "--tag", "hers")
    note("hers", "comes along")
    monkeypatch.setenv("SLAMHIVE_HOME", str(mine.path))
    note("other", "hers has none")
    code, out, err = run_command("archive", "merge", anna.path)
    assert code == 0, err
    assert "notes or tags of 1 run" in out
    assert "run icp-7: a newer note there takes the place of “written first”" in " ".join(err.split())
    now = mine.records()
    assert (now["new"].note, now["new"].tags) == ("written later", ["hers", "mine"])
    assert (now["hers"].note, now["other"].note) == ("comes along", "hers has none")
    code, out, err = run_command("archive", "merge", anna.path)
    assert (code, "notes" in out, mine.records()) == (0, False, now), err
