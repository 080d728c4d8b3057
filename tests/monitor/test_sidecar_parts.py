# SPDX-License-Identifier: Apache-2.0
"""The sidecar's parts by themselves: specification, trajectory, termination message, who is who."""

from __future__ import annotations

import bz2
import gzip
import hashlib
import json
import os
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.contract import trajectory
from slamhive.contract.trajectory import SoundTrajectory, check_trajectory
from slamhive.monitor import ProcessIdentity, SidecarSpec, SpecError
from slamhive.monitor.pod import containers
from slamhive.monitor.pod.containers import Finder, attach_cgroup
from slamhive.monitor.pod.termination import termination_message
from slamhive_eval import FileError, read_tum

if TYPE_CHECKING:
    from pathlib import Path

SPEC = {"container": "algorithm", "runDirectory": "/run"}
POSES = {"path": "a", "format": "Tum", "stamps": "s"}
LINE = "{} 1 2 3 0 0 0 1\n"
LONG = "".join(LINE.format(k / 8) for k in range(20000))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"container": ""}, "container must be the name of a container, not ''"),
        ({"runDirectory": "x"}, "runDirectory must be an absolute path, not 'x'"),
        ({"timeoutSeconds": 0}, "timeoutSeconds must be a number of seconds above 0 or null, not 0"),
        ({"includesReader": 1}, "includesReader must be true or false, not 1"),
        ({"intervalSeconds": 60}, "intervalSeconds must be a number of seconds from 0.01 to 10, not 60"),
        (
            {"poses": {"trajectory": POSES | {"path": "../a"}}},
            "poses must be a description of files with poses",
        ),
        (
            {"poses": {"trajectory": POSES | {"stamps": "frame-index"}}},
            "poses must be a description of files",
        ),
        ({"poses": {"trajectory": POSES | {"format": "Csv", "columns": {}}}}, "poses must be a description"),
        ({"poses": {"trajectory": 1}}, "poses must be a description of files with poses or null, not "),
        ({"poses": {"map": POSES}}, "poses must be a description of files with poses or null, not "),
        ({"colour": 1}, "unknown field colour; known are companions, configuration, container, "),
    ],
)
def test_specification_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError) as caught:
        SidecarSpec.from_json(json.dumps({**SPEC, **change}))
    assert str(caught.value).startswith(message)


def test_specification_round_trip() -> None:
    spec = SidecarSpec.from_json(json.dumps({**SPEC, "dataSeconds": 26, "taskLimit": None}))
    assert SidecarSpec.from_json(spec.to_json()) == spec
    assert spec.termination_message == "/dev/termination-log"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (None, "SLAMHIVE_SIDECAR is not set"),
        ("{", "SLAMHIVE_SIDECAR: not JSON"),
        ("{}", "SLAMHIVE_SIDECAR: container is missing"),
    ],
)
def test_command_refuses(given: str | None, message: str) -> None:
    environment = {key: value for key, value in os.environ.items() if key != "SLAMHIVE_SIDECAR"}
    environment |= {} if given is None else {"SLAMHIVE_SIDECAR": given}
    command = [sys.executable, "-P", "-m", "slamhive.monitor.sidecar"]
    told = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert told.returncode == 2
    assert told.stderr.startswith(message)
    assert told.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "text",
    [
        LINE.format(1) + LINE.format(2),
        "# stamp tx\n\n" + LINE.format(1) + "\n\n" + LINE.format(1),
        (LINE.format(1) + LINE.format(2)).replace("\n", "\r\n"),
        LONG.replace("\n", "\r"),
        LONG.replace("\n", "\r\n"),
        (LINE.format(1) + LINE.format(2)).replace(" ", ", "),
        LINE.format(1).rstrip("\n"),
        "\ufeff" + LONG,
        "1e0 1.0 +2 3E0 0 0 0 1 # first\n2 4 5 6 -0 0.0 0 2\n",
        LONG + "# late\n" + LINE.format(9999),
        "0 1 nan 3 0 0 0 1\n" + LONG + "nan 1 2 3 0 0 0 1\n" + LINE.format(9999),
    ],
)
def test_sound_trajectories(tmp_path: Path, text: str) -> None:
    path = tmp_path / "trajectory.txt"
    path.write_bytes(text.encode())
    found = check_trajectory(str(tmp_path))
    expected = read_tum(path)
    assert found.problem is None
    assert found.info is not None
    assert found.info.poses == len(expected)
    assert found.info.duration_seconds == float(expected.stamps[-1] - expected.stamps[0])
    assert found.info.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("rows", [1, 3])
def test_a_trajectory_of_nan_alone_has_no_pose(tmp_path: Path, rows: int) -> None:
    path = tmp_path / "trajectory.txt"
    path.write_text("# remark\n" + "3000 1 nan 3 0 0 0 1\n" * rows)
    with pytest.raises(FileError) as expected:
        read_tum(path)
    problem = check_trajectory(str(tmp_path)).problem
    assert problem == str(expected.value).replace(str(path), "output/trajectory.txt")
    assert "NaN" in problem


@pytest.mark.parametrize("before", ["", "# remark\n\n", LONG], ids=["first", "third", "late"])
@pytest.mark.parametrize(
    "line",
    [
        "3000 1 2 3 0 0 0",
        "3000 1 2 3 0 0 0 1 9",
        "3000 1 2 three 0 0 0 1",
        "3000 1 2 3_0 0 0 0 1",
        "3000 1 2 " + "x" * 100 + " 0 0 0 1",
        "3000 1 inf 3 0 0 0 1",
        "3000 1 2 -inf 0 0 0 1",
        "3000 1 2 3 0 0 0 inf",
        "1403636580000000000 1 2 3 0 0 0 1",
        "-1e13 1 2 3 0 0 0 1",
        "3000 1e31 2 3 0 0 0 1",
        "3000 1 2 3 0 0 0 0",
        "3000 1 2 3 1e-4 0 -1e-4 0",
        "3000 1 2 3 0 0 0 1\n2999 1 2 3 0 0 0 1",
        "<html>",
        "3000 1 2 3 0 0 0 \0",
    ],
)
def test_faults_are_named_as_the_evaluator_names_them(tmp_path: Path, before: str, line: str) -> None:
    path = tmp_path / "trajectory.txt"
    path.write_text(f"{before}{line}\n")
    with pytest.raises(FileError) as expected:
        read_tum(path)
    found = check_trajectory(str(tmp_path))
    assert found.info is None
    assert found.problem == str(expected.value).replace(str(path), "output/trajectory.txt")
    assert not found.missing


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (gzip.compress(LONG.encode()), "output/trajectory.txt is compressed; it must be plain text"),
        (bz2.compress(LONG.encode()), "output/trajectory.txt is compressed; it must be plain text"),
        (b"x" * 200_000, "line 1: is longer than 64 KiB"),
        (LONG.encode() + b"1 " * 100_000, "line 20001: is longer than 64 KiB"),
        (b"1" * 3_000_000, "is larger than 2 MiB"),
        (os.urandom(50_000), "output/trajectory.txt"),
    ],
)
def test_poisoned_trajectories(tmp_path: Path, data: bytes, part: str) -> None:
    (tmp_path / "trajectory.txt").write_bytes(data)
    found = check_trajectory(str(tmp_path), limit=2 << 20)
    assert found.problem is not None
    assert part in found.problem
    assert len(found.problem) < 300
    assert (found.info, found.missing) == (None, False)


@pytest.mark.parametrize(
    ("poses", "problem"), [(3, None), (4, "output/trajectory.txt: has more than 3 poses")]
)
def test_a_trajectory_has_so_many_poses_and_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, poses: int, problem: str | None
) -> None:
    monkeypatch.setattr(trajectory, "MOST_POSES", 3)
    (tmp_path / "trajectory.txt").write_text("1 0 0 0 0 0 0 1\n" * poses)
    assert check_trajectory(str(tmp_path)).problem == problem


@pytest.mark.parametrize("data", [b"", b"# nothing\n\n", b"\xef\xbb\xbf\r\n"])
def test_a_file_without_a_pose_is_a_trajectory_of_none(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "trajectory.txt").write_bytes(data)
    found = check_trajectory(str(tmp_path))
    assert (found.problem, found.missing) == (None, False)
    assert found.info == SoundTrajectory(0, 0.0, hashlib.sha256(data).hexdigest())


USAGE = {"cpu": {"seconds": 1 / 3}, "memory": {"peakBytes": 5}, "wallSeconds": 2.0000000001}


@pytest.mark.parametrize("text", ["", "short", "x" * 5000, "é\n" * 5000, "\ud800" * 3000, '"\\' * 3000])
@pytest.mark.parametrize("problem", ["", "y" * 4000])
def test_termination_message_fits(text: str, problem: str) -> None:
    counts = {"offered": 1, "processed": None, "dropped": None}
    summary = {
        "reason": "AlgorithmFailed",
        "message": text,
        "usage": USAGE,
        "frames": counts,
        "logTail": "no",
    }
    summary |= {"trajectoryProblem": problem, "trajectoryMissing": False, "cpuModel": "m" * 60}
    data = termination_message(summary)
    told = json.loads(data)
    assert len(data) <= 2048
    assert told["v"] == 1
    assert told["usage"]["cpu"]["seconds"] == 0.333333
    assert told["frames"] == counts
    assert told["cpuModel"] == "m" * 60
    assert "logTail" not in told
    kept = text.encode("utf-8", "replace").decode()
    assert kept.startswith(told["message"].rstrip("…"))
    assert told["message"] == kept or len(told["message"]) >= 40


class FakeProc:
    """First processes of containers, by what they show of their environment; None: they hide it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.shown: dict[int, bytes | None] = {}
        monkeypatch.setattr(containers.os, "listdir", lambda _: [str(pid) for pid in self.shown])
        monkeypatch.setattr(containers.os, "pread", lambda *_: b"0 0 0 1/1 %d" % len(self.shown))
        monkeypatch.setattr(containers, "read_file", self.read)
        monkeypatch.setattr(
            containers, "identify", lambda pid: ProcessIdentity(pid, pid) if pid in self.shown else None
        )

    def read(self, path: str) -> bytes:
        pid, name = int(path.split("/")[2]), path.rpartition("/")[2]
        if name == "environ":
            if self.shown[pid] is None:
                raise PermissionError(path)
            return b"SLAMHIVE_CONTAINER=" + (self.shown[pid] or b"") + b"\0"
        return {
            "stat": b"%d (x) S 0 1" % pid,
            "comm": b"x",
            "status": b"Name:\tx\nUid:\t%d\t0\n" % os.getuid(),
        }[name]


@pytest.mark.parametrize("player", [None, b"player"])
@pytest.mark.parametrize("algorithm", [None, b"algorithm"])
def test_a_player_that_hides_is_not_taken_for_the_algorithm(
    player: bytes | None, algorithm: bytes | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It starts first; what a probe runs in its container is no container of its own."""
    finder = Finder("algorithm", companions=1)
    proc = FakeProc(monkeypatch)
    proc.shown[10] = b"player"
    assert finder.look(0.0) is None
    proc.shown[10] = player
    proc.shown[11] = b"player"
    assert finder.look(60.0) is None
    del proc.shown[11]
    assert finder.look(61.0) is None
    proc.shown[20] = algorithm
    found = [finder.look(62.0), finder.look(90.0)]
    finder.close()
    assert ProcessIdentity(20, 20) in found
    assert finder.by_exclusion == (algorithm is None)


def test_a_player_that_hid_before_anyone_looked(monkeypatch: pytest.MonkeyPatch) -> None:
    finder = Finder("algorithm", companions=1)
    proc = FakeProc(monkeypatch)
    proc.shown[10] = None
    assert [finder.look(0.0), finder.look(60.0)] == [None, None]
    proc.shown[20] = None
    assert [finder.look(61.0), finder.look(90.0)] == [None, ProcessIdentity(20, 20)]
    finder.close()


def test_the_machines_own_cgroups_are_no_container() -> None:
    """Seen from no container but the machine itself: we are in there too."""
    assert attach_cgroup("/sys/fs/cgroup", os.getpid()) is None
    assert attach_cgroup("/nowhere", os.getpid()) is None


def test_imports_stay_light() -> None:
    heavy = "numpy pydantic yaml rich subprocess asyncio argparse pathlib hashlib gzip".split()  # noqa: SIM905
    code = f"import sys, slamhive.monitor.sidecar\nprint([m for m in {heavy} if m in sys.modules])"
    told = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout == "[]\n"
