# SPDX-License-Identifier: Apache-2.0
"""`slamhive plan --estimate`: what sweeps will cost, said of which runs, and what can't be said."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.folder import Home
from slamhive.local.running.outlook import Looking
from slamhive.local.running.workbench import Workbench
from slamhive.model.loading import load_file
from slamhive.model.results import Outcome, Phase, Provenance, Reason, Result, RunRecord, Usage
from slamhive.model.sweep import Sweep
from slamhive.monitor.measuring.machine import cpu_model
from slamhive.plan import Plan, local_uid

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

MANIFEST = """
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: study}
spec:
  template: {spec: {algorithmRef: {name: actor}, datasetRef: {name: tiny}, timeout: 5m}}
  matrix: [{path: parameters.number, values: [1, 2, 4]}]
  repetitions: 4
"""
BEGUN = datetime(2026, 1, 1, tzinfo=UTC)


@dataclass
class Desk:
    """A home with the actor, a sweep, and what can be put into the archive."""

    home: Home
    file: Path
    run: Callable[..., tuple[int, str, str]]

    @property
    def plan(self) -> Plan:
        """Return the sweep's plan."""
        sweep = load_file(self.file)[0]
        assert isinstance(sweep, Sweep)
        workshop = load_workshop(self.home)
        workshop.add(load_file(self.home.path / "tiny.yaml"), self.home.path)
        return Plan(sweep, workshop)

    def keep(self, *indices: int, home: Home | None = None, **fields: Any) -> float:
        """Keep finished runs with the settings of the sweep's, and return their CPU time, s."""
        plan, records = self.plan, []
        for index in indices:
            spec = plan.point(index).spec | {"seed": 1000 + index}
            wall = fields.get("wall", 10.0 * spec["parameters"]["number"] + 0.1 * (index % 4))
            failed = fields.get("reason")
            records.append(
                RunRecord(
                    uid=fields.get("uid", f"{fields.get('name', 'old')}-{index}"),
                    name=f"{fields.get('name', 'old')}-{index}",
                    sweep=fields.get("sweep", "earlier"),
                    sweep_uid="earlier",
                    spec=spec,
                    phase=Phase.FAILED if failed else Phase.SUCCEEDED,
                    reason=failed,
                    created=BEGUN,
                    started=BEGUN + timedelta(seconds=2),
                    finished=BEGUN + timedelta(seconds=2 + wall),
                    usage=Usage.model_validate(
                        {"cpu": {"seconds": 2 * wall}, "memory": {"peakBytes": 10**8}, "wallSeconds": wall}
                        if fields.get("usage", True)
                        else {}
                    ),
                    results=[Result(evaluation="default", outcome=Outcome.TRACKED)],
                    provenance=Provenance(
                        cpu_model=fields.get("processor", cpu_model()),
                        content_hash=fields.get("content", f"{index:064d}"),
                        algorithm_hash=fields.get("algorithm", "a"),
                    ),
                )
            )
        with Archive.open((home or self.home).archive_url) as archive:
            archive.put_runs(records)
        return sum(one.usage.cpu.seconds or 0.0 for one in records if one.usage)

    def contents(self, *indices: int) -> list[str | None]:
        """Return the content hashes that runs of the sweep would have now."""
        plan = self.plan
        with Archive.open(self.home.archive_url) as archive:
            workshop = load_workshop(self.home)
            workshop.add(load_file(self.home.path / "tiny.yaml"), self.home.path)
            looking = Looking(Workbench(self.home, workshop, archive), making=True)
            return [looking.content(plan.point(index)) for index in indices]

    def estimate(self, *words: str) -> dict[str, Any]:
        """Return the estimate."""
        code, out, err = self.run(
            "plan", self.file, self.home.path / "tiny.yaml", "--estimate", "--json", *words
        )
        assert code == 0, err
        (found,) = json.loads(out)
        return found  # type: ignore[no-any-return]

    def text(self, *words: str) -> str:
        """Return the printed estimate."""
        code, out, err = self.run("plan", self.file, self.home.path / "tiny.yaml", "--estimate", *words)
        assert code == 0, err
        return out

    def refused(self, *words: str) -> str:
        """Return the refusal's words."""
        code, out, err = self.run("plan", self.file, self.home.path / "tiny.yaml", "--estimate", *words)
        assert (code, out) == (2, "")
        return err


@pytest.fixture
def desk(
    home: Home,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    run_command: Callable[..., tuple[int, str, str]],
) -> Desk:
    monkeypatch.setenv("SLAMHIVE_HOME", str(home.path))
    for name in ("SLAMHIVE_ARCHIVE", "SLAMHIVE_ALSO"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "study.yaml").write_text(MANIFEST)
    return Desk(home, tmp_path / "study.yaml", run_command)


def test_a_sweep_whose_runs_are_known_costs_their_sum(desk: Desk) -> None:
    cpu = desk.keep(*range(12))
    found = desk.estimate("-j", "1")
    assert found["runs"] == 12
    assert found["nearest"] == {"the same settings": 12}
    assert found["cpuSeconds"]["estimate"] == pytest.approx(cpu, rel=0.03)
    assert found["cpuSeconds"]["low"] < cpu < found["cpuSeconds"]["high"]
    assert found["wallSeconds"]["estimate"] == pytest.approx(cpu / 2 + 12 * 2, rel=0.03)
    assert found["memoryBytes"]["estimate"] == pytest.approx(10**8, rel=0.2)


def test_wall_time_is_that_of_so_many_at_a_time(desk: Desk) -> None:
    desk.keep(*range(12))
    walls = {at: desk.estimate("-j", str(at))["wallSeconds"]["estimate"] for at in (1, 2, 1000)}
    assert walls[2] == pytest.approx(walls[1] / 2, rel=0.15)
    assert walls[1000] == pytest.approx(42, rel=0.1)  # the longest of them, and until it begins
    assert "12 at a time" in desk.text("-j", "1000")
    assert "as if there were room" in desk.text("-j", "1000")


def test_runs_with_the_machine_for_themselves_are_expected_one_after_another(desk: Desk) -> None:
    desk.keep(*range(12))
    one = desk.estimate("-j", "1")["wallSeconds"]["estimate"]
    desk.file.write_text(MANIFEST.replace("timeout: 5m", "timeout: 5m, resources: {exclusiveNodes: true}"))
    alone = desk.estimate()
    assert alone["nearest"] == {"the same settings": 12}
    assert alone["wallSeconds"]["estimate"] == pytest.approx(one)


def test_the_farther_the_known_runs_are_the_wider_the_interval(desk: Desk) -> None:
    desk.keep(*range(12))
    same = desk.estimate()["cpuSeconds"]
    desk.file.write_text(MANIFEST.replace("[1, 2, 4]", "[3, 7, 9]"))
    other = desk.estimate()
    assert other["nearest"] == {"other settings on the dataset": 12}
    told = other["cpuSeconds"]
    assert told["high"] / told["low"] > 1.5 * same["high"] / same["low"]


def test_an_algorithm_that_never_ran_is_named_and_not_counted(desk: Desk) -> None:
    desk.keep(*range(12))
    cpu = desk.estimate()["cpuSeconds"]
    text = MANIFEST.replace("algorithmRef: {name: actor}, ", "")
    desk.file.write_text(
        text.replace("matrix: [", "matrix: [{path: algorithm, values: [actor, kiss-icp]}, ").replace(
            "{path: parameters.number, values: [1, 2, 4]}", "{path: timeout, values: [1m, 2m, 4m]}"
        )
    )
    found = desk.estimate()
    assert found["unknown"] == {"kiss-icp": 12}
    assert found["runs"] == 12
    assert found["cpuSeconds"]["estimate"] != cpu["estimate"]
    assert "12 runs of kiss-icp not counted: no run of it is known" in desk.text()


def test_runs_that_take_over_an_equal_result_cost_nothing(desk: Desk) -> None:
    desk.keep(*range(12))
    before = desk.estimate()
    for number, content in enumerate(desk.contents(0, 4, 8)):
        desk.keep(4 * number, name=f"equal{number}", content=content)
    found = desk.estimate()
    assert (found["runs"], found["reused"]) == (9, 3)
    assert found["cpuSeconds"]["estimate"] == pytest.approx(0.75 * before["cpuSeconds"]["estimate"], rel=0.05)
    assert "3 runs with an equal result to take over: not counted" in desk.text()


def test_prepared_recordings_that_are_missing_are_counted(desk: Desk) -> None:
    desk.keep(*range(12))
    desk.file.write_text(MANIFEST.replace("matrix: [", "matrix: [{path: input.frameRate, values: [5, 2]}, "))
    needed = desk.estimate()["recordings"]
    assert (needed["made"], needed["toMake"], needed["unknown"]) == (0, 2, [])
    assert needed["bytes"] > 10_000
    assert "2 prepared recordings to be made first, up to about" in desk.text()
    plan, workshop = desk.plan, load_workshop(desk.home)
    workshop.add(load_file(desk.home.path / "tiny.yaml"), desk.home.path)
    with Archive.open(desk.home.archive_url) as archive:
        bench = Workbench(desk.home, workshop, archive)
        bench.prepare(plan.point(0).spec, workshop.algorithm("actor").algorithm)
    needed = desk.estimate()["recordings"]
    assert (needed["made"], needed["toMake"]) == (1, 1)


def test_nothing_is_changed_by_looking(desk: Desk) -> None:
    desk.keep(*range(12))
    file = desk.home.path / "archive.sqlite"
    before = file.read_bytes()
    desk.text()
    assert file.read_bytes() == before
    assert not (desk.home.path / "runs").exists()


def test_failed_runs_are_left_out_but_for_those_that_hit_the_time_limit(desk: Desk) -> None:
    desk.keep(*range(12))
    good = desk.estimate()["cpuSeconds"]["estimate"]
    desk.keep(*range(12), name="crashed", reason=Reason.ALGORITHM_FAILED, wall=0.1)
    found = desk.estimate()
    assert found["cpuSeconds"]["estimate"] == pytest.approx(good)
    assert found["failedLeftOut"] == 12
    desk.keep(*range(12), name="late", reason=Reason.DEADLINE_EXCEEDED, wall=300.0)
    found = desk.estimate()
    assert found["atTimeLimit"] == 12
    assert found["cpuSeconds"]["estimate"] > 2 * good
    assert "12 that hit the time limit count as that" in desk.text()


def test_another_processor_widens_the_interval_and_is_named(desk: Desk) -> None:
    desk.keep(*range(12))
    here = desk.estimate()["cpuSeconds"]
    desk.keep(*range(12), processor="Some Processor 3000")
    there = desk.estimate()["cpuSeconds"]
    assert there["high"] / there["low"] > 1.5 * here["high"] / here["low"]
    assert "12 on Some Processor 3000" in desk.text()


def test_runs_of_another_home_tell_too_each_once(desk: Desk, tmp_path: Path) -> None:
    (tmp_path / "anna").mkdir()
    anna = Home.at(tmp_path / "anna")
    desk.keep(*range(12), home=anna)
    desk.keep(0, 1)
    found = desk.estimate("--also", str(anna.path))
    assert found["cpuSeconds"]["fromRuns"] == 12


def test_an_algorithm_of_the_same_name_that_is_another_one_is_not_mixed_in(
    desk: Desk, tmp_path: Path
) -> None:
    (tmp_path / "anna").mkdir()
    anna = Home.at(tmp_path / "anna")
    desk.keep(*range(12))
    desk.keep(*range(12), home=anna, name="hers", algorithm="another", wall=5000.0)
    alone, both = desk.estimate(), desk.estimate("--also", str(anna.path))
    assert both["cpuSeconds"]["fromRuns"] == 12
    assert both["cpuSeconds"]["estimate"] == pytest.approx(alone["cpuSeconds"]["estimate"], rel=0.1)


def test_what_is_finished_costs_nothing(desk: Desk) -> None:
    desk.keep(*range(12))
    for index, content in zip((0, 4, 8), desk.contents(0, 4, 8), strict=True):
        uid = f"{local_uid(desk.plan.sweep)[:16]}-{index}"
        desk.keep(index, uid=uid, sweep="study", content=content)
    found = desk.estimate()
    assert (found["runs"], found["finished"], found["reused"]) == (9, 3, 0)
    assert "3 runs finished already: not counted" in desk.text()
    for index, content in enumerate(desk.contents(*range(12))):
        uid = f"{local_uid(desk.plan.sweep)[:16]}-{index}"
        desk.keep(index, uid=uid, sweep="study", content=content)
    assert "no run to be done is counted" in desk.text()
    found = desk.estimate()
    assert (found["runs"], found["finished"]) == (0, 12)
    assert "cpuSeconds" not in found


def test_where_nothing_ran_it_is_refused(desk: Desk) -> None:
    assert "nothing has run here yet" in desk.refused()


def test_an_archive_without_figures_is_refused(desk: Desk) -> None:
    desk.keep(*range(12), usage=False)
    assert "no finished run of actor has figures of CPU, wall time or memory" in desk.refused()


def test_an_archive_of_a_newer_version_is_refused(desk: Desk, tmp_path: Path) -> None:
    (tmp_path / "anna").mkdir()
    anna = Home.at(tmp_path / "anna")
    desk.keep(0)
    desk.keep(0, home=anna)
    with sqlite3.connect(anna.path / "archive.sqlite") as database:
        database.execute("UPDATE slamhive_schema SET version = 99")
    assert "home anna" in desk.refused("--also", str(anna.path))
    assert "newer slamhive" in desk.refused("--also", str(anna.path))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--estimate", "-j", "0"), "--parallelism"),
        (("--estimate", "--count"), "--estimate"),
        (("--estimate", "--head", "3"), "--estimate"),
        (("-j", "2"), "--estimate"),
        (("--estimate", "--also", "/nowhere"), "/nowhere"),
    ],
)
def test_wrong_options_are_refused(desk: Desk, words: tuple[str, ...], told: str) -> None:
    code, out, err = desk.run("plan", desk.file, *words)
    assert (code, out) == (2, "")
    assert told in err
