# SPDX-License-Identifier: Apache-2.0
"""Searches on the command line: what is said of them before, on the way and after, and what is refused."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.cli.parts.searches import progress_text
from slamhive.model.search import Search

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.local.home.folder import Home

    Command = Callable[..., tuple[int, str, str]]

SEARCH: dict[str, Any] = {"method": "Random", "objectives": [{"metric": "metrics.score"}], "trials": 3}
RANGE: dict[str, Any] = {"path": "parameters.number", "range": {"from": 0, "to": 20}}
RATE: dict[str, Any] = {"path": "input.frameRate", "range": {"from": 2, "to": 10}}


@pytest.fixture
def write(home: Home, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Writes a search over numbers into a file; fields of the search, and of the spec."""
    monkeypatch.setenv("SLAMHIVE_HOME", str(home.path))
    for name in ("SLAMHIVE_ARCHIVE", "SLAMHIVE_ALSO"):
        monkeypatch.delenv(name, raising=False)

    def written(search: dict[str, Any] | None = None, **spec: Any) -> Path:
        template = {"algorithmRef": {"name": "actor"}, "datasetRef": {"name": "tiny"}}
        body = {
            "apiVersion": "slamhive.io/v1alpha1",
            "kind": "Sweep",
            "metadata": {"name": "searched"},
            "spec": {
                "template": {"spec": template | {"parameters": {"act": "scored"}}},
                "matrix": [RANGE],
                "search": SEARCH | (search or {}),
                **spec,
            },
        }
        file = home.path / "search.yaml"
        file.write_text(f"{(home.path / 'tiny.yaml').read_text()}---\n{yaml.safe_dump(body)}")
        return file

    return written


def plain(text: str) -> str:
    """Return a text without its line ends."""
    return " ".join(text.split())


@pytest.mark.parametrize(
    ("search", "spec", "said"),
    [
        ({}, {"repetitions": 3}, "repetitions: a search has its own, search.repetitions"),
        (
            {},
            {"matrix": [{"path": "parameters.number", "values": [3]}]},
            "has one value, so nothing to search",
        ),
        ({}, {"matrix": [RANGE, RANGE]}, "parameters.number"),
        ({}, {"matrix": [{**RANGE, "range": {"from": -4, "to": 20}}]}, "-4 is below the minimum"),
        ({}, {"matrix": [{**RANGE, "range": {"from": 0, "to": 20, "scale": "Log"}}]}, "ends above zero"),
        ({"objectives": []}, {}, "objectives: the method Random needs it"),
        ({"trials": None}, {}, "trials: the method Random needs it"),
        ({"objectives": [{"metric": "ate.rms"}]}, {}, "objectives[0].metric: no evaluation yields 'ate.rms'"),
        ({"objectives": [{"metric": "parameters.number"}]}, {}, "is a setting of runs, not a figure"),
        ({"axis": "parameters.number"}, {}, "axis: means nothing to the method Random"),
        ({"across": ["datasett"]}, {}, "'datasett' is no label of an axis"),
        ({"repetitions": {"first": 3, "promote": 2}}, {}, "promote: 2 is less than first, 3"),
        ({}, {"include": [{"parameters.number": 3}]}, "include: a search adds no points"),
    ],
)
def test_what_is_no_search_is_refused(
    write: Callable[..., Path], run_command: Command, search: dict[str, Any], spec: dict[str, Any], said: str
) -> None:
    code, _, err = run_command("validate", write(search, **spec))
    assert code == 2
    assert said in plain(err)


@pytest.mark.parametrize("option", [("--only", "repetition == 0"), ("--first", "2"), ("--dataset", "tiny")])
def test_runs_of_a_search_are_not_chosen_by_hand(
    write: Callable[..., Path], run_command: Command, option: tuple[str, str]
) -> None:
    code, _, err = run_command("run", write(), *option)
    assert (code, f"{option[0]}: searched is a search" in plain(err)) == (2, True)


@pytest.mark.parametrize(
    ("search", "spec", "said"),
    [
        ({}, {}, "search Random, tries 3 of 21 settings, at least 3 and at most 3 runs"),
        (
            {"repetitions": {"first": 2, "promote": 4}},
            {"matrix": [RATE]},
            "search Random, tries 3 of any number of settings, at least 6 and at most 12 runs",
        ),
        (
            {"trials": 50},
            {},
            "spec.search.trials: 50 are asked for, the matrix has 21 settings: all are tried",
        ),
    ],
)
def test_a_plan_says_how_much_is_tried(
    write: Callable[..., Path], run_command: Command, search: dict[str, Any], spec: dict[str, Any], said: str
) -> None:
    for command in ("plan", "validate"):
        code, out, err = run_command(command, write(search, **spec))
        assert (code, said in plain(out + err)) == (0, True), out + err


@pytest.mark.parametrize(("is_complete", "more"), [(False, " (after 1 run, not all)"), (True, "")])
def test_a_best_of_fewer_runs_than_all_says_so(is_complete: bool, more: str) -> None:
    score = SimpleNamespace(values=(0.5,), failed=0)
    best = SimpleNamespace(number=0, score=score, runs=1, is_complete=is_complete)
    space = SimpleNamespace(setting=lambda _: SimpleNamespace(coordinates={"parameters.number": 3}))
    asked = Search.model_validate({"method": "TPE", "objectives": [{"metric": "ate.rmse"}], "trials": 3})
    plan = SimpleNamespace(trials=[SimpleNamespace(values=[3])], most_trials=3, space=space)
    under_way: Any = SimpleNamespace(plan=plan, search=asked, seen={0: None}, best=[best])
    assert progress_text(under_way) == f"trial 1 of 3, 1 run, best ate.rmse 0.5 m at number 3{more}"


def test_a_search_is_run_and_said_in_words(write: Callable[..., Path], run_command: Command) -> None:
    file = write()
    code, out, err = run_command("run", file, "-j", "1")
    assert code == 0, err
    assert "searched: trial 3 of 3, 1 run, best metrics.score 36 at number 13" in plain(err)
    assert "Best: metrics.score" in plain(out)
    assert "(mean of 1 run)" in plain(out)
    assert "Search: 3 runs of the 21 of a grid; 3 settings tried" in plain(out)
    assert "searched: 3 runs: 3 succeeded, 0 failed" in plain(out)
    _, out, _ = run_command("plan", file, "--json")
    lines = [json.loads(line) for line in out.splitlines()]
    assert [line["index"] for line in lines] == [0, 1, 2]
    _, out, err = run_command("plan", file)
    assert "3 runs are as before" in plain(out)
    # What was tried and is asked for again: nothing is done.
    code, out, _ = run_command("run", file, "--log-format", "json")
    end = [json.loads(line) for line in out.splitlines()][-2]
    assert (code, end["doneBefore"], end["notRun"], end["verdict"]) == (0, 3, 0, "Complete")
    assert (end["search"]["trials"], end["search"]["isOver"], len(end["search"]["best"])) == (3, True, 2)
    # More of them, forecast by those that have run; then done.
    file = write({"trials": 5})
    code, out, err = run_command("plan", file, "--estimate")
    assert (code, "of which 5 runs are likely" in plain(out)) == (0, True), out + err
    assert "3 runs finished already: not counted" in plain(out)
    assert "2 runs to be done" in plain(out)
    code, out, _ = run_command("run", file, "--rerun-where", "metrics.score > 0")
    assert (code, "5 settings tried" in plain(out)) == (0, True)
    # Fewer than were tried: nothing is done, and it is said why.
    file = write({"trials": 4})
    told = "5 settings are tried already, trials: 4 asks for fewer: none is added"
    for command in ("plan", "run"):
        code, out, err = run_command(command, file)
        assert (code, told in plain(out + err)) == (0, True), out + err
