# SPDX-License-Identifier: Apache-2.0
"""Edit after edit of an algorithm and a dataset: each comparison tells the last one, of all sweeps."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from slamhive.cli.daily import show_edits
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.plan import Plan, local_uid

from .sweeps import Notes, edit_recording, sweep_of

if TYPE_CHECKING:
    import pytest

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home


def test_each_comparison_tells_what_changed_since_the_last_one(
    home: Home, workshop: Workshop, bench: Workbench, capsys: pytest.CaptureFixture[str]
) -> None:
    sweeps = [
        sweep_of([], f"run-{number}", matrix=[{"path": "parameters.number", "values": [number]}])
        for number in range(3)
    ]
    adapter = home.path / "algorithms/actor/adapter.py"
    good = adapter.read_text()

    def told(count: int = 3) -> tuple[list[str], list[list[str]], str]:
        """Run some of them; return the headings, the lines of figures, and the remarks."""
        jobs = [Job(sweep, local_uid(sweep), Plan(sweep, workshop)) for sweep in sweeps[:count]]
        Runner(Workbench(home, workshop, bench.archive), Notes(), parallelism=2).run(jobs)
        capsys.readouterr()
        show_edits(jobs, home)
        out, err = capsys.readouterr()
        headings = re.findall(r"^Before and after: (\w+) \w+ \(.*\) → \w+: (.*)$", out, re.MULTILINE)
        lines = [
            re.split(r"\s{2,}", line.strip()) for line in out.splitlines() if re.search(r" \d$|  ", line)
        ]
        return [" ".join(one) for one in headings], lines[1:], err

    assert told() == ([], [], "")
    adapter.write_text(f"raise SystemExit(1)\n{good}")
    headings, lines, _ = told()
    # Runs that nobody made into one sweep are compared together all the same.
    assert headings == ["actor adapter.py changed"]
    assert [line[-7:-1] for line in lines[1:2]] == [["0 of 3", "3 of 3", "+3", "0", "3", "0"]]
    assert not [line for line in lines if "CPU" in line[0]]
    edit_recording(workshop, home, seed=7)
    headings, lines, _ = told()
    assert headings == ["tiny the dataset tiny changed"]
    assert lines[0][-7:] == ["failed", "failed", "–", "0", "0", "0", "failed before and after"]
    # One run with another edit doesn't stand for what most of them were before.
    adapter.write_text(f"raise SystemExit(2)\n{good}")
    told(1)
    adapter.write_text(f"{good}\n")
    headings, lines, remarks = told()
    assert headings == ["actor adapter.py changed"]
    assert [line[-7:-1] for line in lines[1:2]] == [["3 of 3", "0 of 3", "-3", "3", "0", "0"]]
    assert "not compared" not in remarks
    adapter.write_text(good)
    edit_recording(workshop, home, seed=8)
    headings, _, remarks = told()
    assert headings == []
    assert remarks.startswith("actor, tiny were edited together: no run tells what each edit did")
    # Where runs before tell what one of the edits did, that one is compared, and the other is named.
    adapter.write_text(f"{good}\n")
    told()
    adapter.write_text(good)
    edit_recording(workshop, home, seed=9)
    headings, _, remarks = told()
    assert headings == ["tiny the dataset tiny changed"]
    assert "actor was edited together with tiny: no run tells what that edit did" in remarks
