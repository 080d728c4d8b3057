# SPDX-License-Identifier: Apache-2.0
"""A disk that fails at any write of a Job: its message says so, and the next one has the whole result."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from injecting import Command, Done, Fault

if TYPE_CHECKING:
    from injecting import Call, Injector

ACTOR = Path(__file__).parents[1] / "actor"
UID = "00000001-0000-4000-8000-000000000000"


class Pod:
    """The volumes of a Job's pod."""

    def __init__(self, folder: Path, injector: Injector, program: str, request: Any) -> None:
        self.root = folder / "slamhive"
        self.last = folder / "termination-log"
        self._injector = injector
        self._program = program
        for name in ("data/datasets", "results/runs", "output", "request", "groundtruth"):
            (self.root / name).mkdir(parents=True)
        (self.root / "request" / "request.json").write_text(json.dumps(request))

    def run(self, fault: Fault | None) -> Done:
        command = Command(
            (self._program,),
            {"SLAMHIVE_TERMINATION_LOG": str(self.last)},
            f"slamhive.jobs.{self._program}",
            "main",
            (["--root", str(self.root)],),
        )
        return self._injector.run(command, self.root, fault)

    def told(self) -> Any:
        return json.loads(self.last.read_text())

    def left(self) -> dict[str, str]:
        """Return the files that others read, by their content."""
        found = {}
        for path in sorted(self.root.rglob("*")):
            name = path.relative_to(self.root).as_posix()
            if path.is_file() and not any(part.startswith(".") for part in path.relative_to(self.root).parts):
                content = path.read_bytes()
                if path.name == "variant.json":  # it knows when its recording was made
                    content = json.dumps(json.loads(content) | {"state": None}).encode()
                # Findings are kept by the state of files, which no other pod's have.
                name = re.sub(r"generated/findings/\w+", "generated/findings/ANY", name)
                found[name] = hashlib.sha256(content).hexdigest()
        return found


def each_kind(calls: list[Call]) -> list[Fault]:
    """Return a fault for each kind of call and file, their errors in turn; of a large file its last write."""
    from scene import form_of

    kinds: dict[tuple[str, str], list[Call]] = {}
    for call in calls:
        kinds.setdefault((call.name, form_of(call.path)), []).append(call)
    found = []
    for k, ((name, form), same) in enumerate(sorted(kinds.items())):
        wanted = same[-1].kinds
        found.append(Fault(len(same), wanted[k % len(wanted)], call=name, form=form))
    return found


def prepare_request(target: str) -> Any:
    dataset = yaml.safe_load((ACTOR / "tiny.yaml").read_text())
    return {
        "dataset": dataset,
        "roles": ["lidar"],
        "input": {"frameRate": 5, "duration": "2s"},
        "formats": [target],
        "assets": [],
    }


def evaluate_request(folder: Path) -> Any:
    """Lay out a run and its ground truth, and ask for its evaluation."""
    poses = "".join(f"{k / 10} {k / 10} {k % 7 / 10} 0 0 0 0 1\n" for k in range(100))
    place = folder / "results" / "runs" / UID / UID / "output"
    place.mkdir(parents=True)
    for path in (place / "trajectory.txt", folder / "groundtruth" / "walk.txt"):
        path.write_text(poses)
    run = {"uid": UID, "name": "one", "folder": f"runs/{UID}/{UID}", "dataset": "walk", "mode": "lidar"}
    run["sha256"] = hashlib.sha256(poses.encode()).hexdigest()
    return {"runs": [run, run | {"name": "two"}], "settings": {}}


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "what",
    [
        "Rosbag1",
        pytest.param("Rosbag2", marks=pytest.mark.slow),
        pytest.param("Mcap", marks=pytest.mark.slow),
        "evaluate",
    ],
)
def test_a_fault_at_any_write_is_told_and_mended_by_the_next(
    what: str, injector: Injector, tmp_path: Path
) -> None:
    program = "evaluate" if what == "evaluate" else "prepare"

    def pod(name: str) -> Pod:
        made = Pod(tmp_path / name, injector, program, {} if program == "evaluate" else prepare_request(what))
        if program == "evaluate":
            request = evaluate_request(made.root)
            (made.root / "request" / "request.json").write_text(json.dumps(request))
        return made

    whole = pod("whole")
    done = whole.run(None)
    assert done.code == 0, done.err
    # Making the recording takes longest; the sweep's faults are there too.
    faults = [fault for fault in each_kind(done.calls) if "generated" not in str(fault.form)]
    assert len(faults) >= (5 if program == "evaluate" else 15)
    problems = []
    for number, fault in enumerate(faults):
        one = pod(f"pod-{number}")
        if program == "prepare":
            shutil.copytree(whole.root / "data" / "generated", one.root / "data" / "generated")
        failed = one.run(fault)
        told = one.told()
        assert failed.calls, fault
        if failed.code == 0:
            problems += [f"{fault}: not told"] * (one.left() != whole.left())
        else:
            error = told["error"]
            plain = error["reason"] == "SystemFault" and "unforeseen" not in error["message"]
            problems += [f"{fault}: {error}"] * (not plain or "Traceback" in failed.err)
        again = one.run(None)
        if again.code or one.left() != whole.left():
            differ = sorted(name for name, _ in one.left().items() ^ whole.left().items())
            problems.append(f"{fault}: afterwards {differ} {again.err[-300:]}")
        shutil.rmtree(one.root.parent)
    assert "\n".join(problems) == ""
