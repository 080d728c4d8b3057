# SPDX-License-Identifier: Apache-2.0
"""Table of behaviours: what an executor must make of each one of algorithm.py, down to the columns.

Any two executors are equal but for what a row names as a difference, with its reason. The message is the
whole sentence: it says the same to a user wherever the algorithm ran. Processes are held to all of the table;
in containers, tests have some behaviours stand for others (`STANDING_FOR`).
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, replace
from hashlib import sha256
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from executors import algorithm
from executors.executor import BEHAVIOUR, REUSED, Row, outcomes

from slamhive.analysis.flattening import spread

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from executors.executor import Executor

HERE = Path(__file__).parent
MEASURED = HERE / "measured.json"
"""Columns of a run with all poses, as they are after an evaluation."""
BESIDE = HERE / "beside.json"
"""Columns of what lies beside the trajectory, by the behaviours that leave such."""
OF_ANY = ("attempts", "evaluation", "alignment", "prepared.")
"""Those of them that runs without a result have too; names or how they begin."""
OF_REFERENCE = ("evaluationVersion", "keyframes", "pathLength", "referencePoses")
"""Those that a lost run has too."""
FRAMES = 100
"""Of the recording: so many are offered to an algorithm that does not count them."""
NAME = "behaving"
FAILED, SUCCEEDED = "Failed", "Succeeded"
ALL_POSES = "".join(algorithm.lines())
MACHINE_FAULTS = 3
"""Attempts that a busy machine may end; what an algorithm does is never tried again."""
TIMEOUT_SECONDS = 3
"""Of those that do not end by themselves; others have minutes, so that no machine is too slow."""


@dataclass(frozen=True)
class Difference:
    """Difference that an outcome must have on one executor, with the reason for it.

    Attributes:
        why: the reason.
        changes: other values of fields of a `Behaviour`.
    """

    why: str
    changes: Mapping[str, Any]


@dataclass(frozen=True)
class Behaviour:
    """Expected outcome of a run whose algorithm shows one behaviour of the table.

    Attributes:
        phase: Failed or Succeeded.
        reason: why it failed.
        message: the run's sentence, None for none.
        trajectory: text of the trajectory that is told of, None where none is.
        frames: offered, processed and dropped, as far as the algorithm counted them.
        metrics: the algorithm's own values that are kept.
        outcome: of the evaluation; None where there is none.
        beside: behaviour whose figures of what lies beside the trajectory are kept; None: there are none.
        asked: other fields of the run's spec.
        differs: differences by the name of an executor.
    """

    phase: str
    reason: str | None = None
    message: str | None = None
    trajectory: str | None = None
    frames: Mapping[str, int] = field(default_factory=dict)
    metrics: Mapping[str, Any] = field(default_factory=dict)
    outcome: str | None = None
    beside: str | None = None
    asked: Mapping[str, Any] = field(default_factory=dict)
    differs: Mapping[str, Difference] = field(default_factory=dict)

    def on(self, executor: str) -> Behaviour:
        """Return the behaviour as it must be on an executor."""
        difference = self.differs.get(executor)
        return self if difference is None else replace(self, **difference.changes)

    def columns(self) -> Row:
        """Return the outcome's columns."""
        known: Row = json.loads(MEASURED.read_text(encoding="utf-8"))
        row = {name: known[name] for name in known if name.startswith(OF_ANY) and name not in OF_REFERENCE}
        if self.outcome == "Tracked":
            row |= known
        if self.outcome == "Lost":
            row |= {name: known[name] for name in OF_REFERENCE}
            row |= {"coverage": 0.0, "coveredLength": 0.0, "estimatePoses": len(self._stamps()), "poses": 0}
        row |= {"phase": self.phase, "reason": self.reason, "message": self.message, "outcome": self.outcome}
        if self.beside is not None:
            row |= json.loads(BESIDE.read_text(encoding="utf-8"))[self.beside]
        row["status"] = self.outcome or self.reason or "NotEvaluated"
        told = {"frames": {"offered": FRAMES} | dict(self.frames), "metrics": self.metrics}
        columns: dict[str, Sequence[Any]] = {}
        spread(columns, "", [told | {"trajectory": self._trajectory()}])
        row |= {name: value for name, (value,) in columns.items()}
        return {name: value for name, value in row.items() if value is not None} | {REUSED: False}

    def _trajectory(self) -> dict[str, Any] | None:
        if self.trajectory is None:
            return None
        stamps = self._stamps()
        return {
            "poses": len(stamps),
            "durationSeconds": round(stamps[-1] - stamps[0], 6) if stamps else 0.0,
            "sha256": sha256(self.trajectory.encode()).hexdigest(),
        }

    def _stamps(self) -> list[float]:
        lines = (self.trajectory or "").splitlines()
        return [float(line.split()[0]) for line in lines if not line.startswith("#")]


def failed(reason: str, message: str, **more: Any) -> Behaviour:
    """Return a behaviour that ends its run."""
    return Behaviour(FAILED, reason, message, **more)


def measured(message: str | None = None, **more: Any) -> Behaviour:
    """Return a behaviour that has a result, whatever else is to be said of it."""
    return Behaviour(SUCCEEDED, None, message, **({"trajectory": ALL_POSES, "outcome": "Tracked"} | more))


def lost(message: str, trajectory: str) -> Behaviour:
    """Return a behaviour whose result is that it is lost."""
    return Behaviour(SUCCEEDED, None, message, trajectory, outcome="Lost")


def crashed(message: str, **more: Any) -> Behaviour:
    """Return a behaviour that ends by an exit code or a signal."""
    return failed("AlgorithmFailed", message, **more)


def endless(reason: str, message: str) -> Behaviour:
    """Return a behaviour that is ended."""
    return failed(reason, message, asked={"timeout": f"{TIMEOUT_SECONDS}s"})


def without(message: str = "is missing or not a regular file") -> Behaviour:
    """Return a behaviour that leaves no trajectory."""
    return failed("NoTrajectory", f"output/trajectory.txt {message}")


def invalid(message: str) -> Behaviour:
    """Return a behaviour that leaves a trajectory that can't be used."""
    return failed("InvalidTrajectory", f"output/trajectory.txt{message}")


TOO_LONG = f"it took more than {TIMEOUT_SECONDS} s"
IGNORED = "output/metrics.json is no JSON object of at most 4 MiB and was ignored"
LEFT_OUT = "output/metrics.json: left out"
NAME_RULE = "(a name must have 1 to 100 printable characters)"
COUNTED = {"offered": 100, "processed": 99, "dropped": 1}
SAID = {"framesOffered": 100, "framesProcessed": 99, "framesDropped": 1, "keyframes": 12}
RIGHTS = "a workstation's program has all rights of the user who runs it, and runs beside its run folder"

EVERY_FRAME = [(1600000000 * 10 + k, line.split()[1:3]) for k, line in enumerate(algorithm.lines())]
KITTI_POSES = "".join(
    f"{tenths // 10}.{tenths % 10}00000000 {x} {y} 0 0.0 0.0 0.0 1.0\n" for tenths, (x, y) in EVERY_FRAME
)
EUROC_POSES = "".join(
    f"{tenths // 10}.{tenths % 10}00000000 {float(x)} {float(y)} -0.0 -0.0 -0.0 -0.0 1.0\n"
    for tenths, (x, y) in EVERY_FRAME
)
TABLE_POSES = "".join(
    f"{tenths // 10}.{tenths % 10}00000000 {x} {y} 0 0 0 0 1\n" for tenths, (x, y) in EVERY_FRAME
)
"""Content of the contract's file when the poses of a program's own file were converted."""
KITTI_MODE, EUROC_MODE, TABLE_MODE = ({"sensors": mode} for mode in ("stereo", "stereo-inertial", "rgbd"))
OWN_FILES = {
    "stereo": {"trajectory": {"path": algorithm.KITTI_FILE, "format": "Kitti"}},
    "stereo-inertial": {
        "trajectory": {"path": algorithm.EUROC_FILE, "format": "Euroc", "inverted": True},
    },
    "rgbd": {
        "trajectory": {
            "path": algorithm.TABLE_FILE,
            "format": "Csv",
            "stamps": "frame-index",
            "columns": {
                "timestamp": "frame",
                "tx": "px",
                "ty": "py",
                "tz": "pz",
                "qx": "i",
                "qy": "j",
                "qz": "k",
                "qw": "r",
            },
        },
        "keyframes": {"path": algorithm.KEYFRAMES_FILE, "format": "Tum", "stamps": "ns"},
    },
}
"""Modes in which the program writes its poses in its own way; each takes the LiDAR alone."""

ENDING = {
    "well": measured(frames=COUNTED, metrics=SAID),
    "crash-before-configuration": crashed(
        "exit code 1: no graphics card was found", asked={"seed": int(algorithm.BEFORE_CONFIGURATION)}
    ),
    "crash-before-first-pose": crashed("exit code 3: the voxel map is empty"),
    "crash-between-poses": crashed("exit code 4: lost the map after 50 poses"),
    "crash-after-last-pose": crashed(
        "exit code 5: the map can't be saved", trajectory=ALL_POSES, frames=COUNTED, metrics=SAID
    ),
    "exit-1": crashed("exit code 1", trajectory=ALL_POSES),
    "exit-137": crashed(
        "exit code 137",
        trajectory=ALL_POSES,
        differs=dict.fromkeys(
            ("cluster", "container"),
            Difference(
                "a container runtime tells of a signal as an exit code, its number and 128",
                {"message": "ended by signal 9 (SIGKILL)"},
            ),
        ),
    ),
    "exit-255": crashed("exit code 255", trajectory=ALL_POSES),
    "segfault": crashed("ended by signal 11 (SIGSEGV)"),
    "abort": crashed("ended by signal 6 (SIGABRT)"),
    "killed": crashed("ended by signal 9 (SIGKILL)"),
    "terminated": crashed("ended by signal 15 (SIGTERM)"),
    "real-time-signal": crashed("ended by signal 37 (SIGRTMIN+3)"),
    "hang": endless("DeadlineExceeded", TOO_LONG),
    "deaf": endless("DeadlineExceeded", TOO_LONG),
    "forks": endless("DeadlineExceeded", TOO_LONG),
    "log": endless("DeadlineExceeded", TOO_LONG),
    "memory": failed("OutOfMemory", "it needed more memory than its limit of 128 MiB"),
    "orphans": measured(),
    "kitti-and-crash": crashed("exit code 4", trajectory=KITTI_POSES, asked=KITTI_MODE),
    "compressed-segments": measured(
        "not evaluated: output/segments.csv is compressed; it must be plain text",
        outcome=None,
    ),
    "flood": measured(),
    "output-too-large": failed("OutputTooLarge", "its output grew beyond the limit of 8192 MiB"),
    "outside": crashed(
        "exit code 5: nothing outside of the output can be written",
        differs={"process": Difference(RIGHTS, {"message": "exit code 6: wrote to neighbour"})},
    ),
}
"""Ends of programs, and what is too much."""

LEAVING = {
    "not-a-number": invalid(": all 100 rows hold NaN: no pose"),
    "words": invalid(", line 1: found 4 of 8 values; expected timestamp tx ty tz qx qy qz qw"),
    "unsorted": invalid(
        ", line 2: time stamp 1600000009.799999952 s comes before the one above it, 1600000009.900000095 s; "
        "stamps must not decrease"
    ),
    "garbage": invalid(": is no text file (it holds zero bytes)"),
    "endless-line": invalid(", line 1: is longer than 64 KiB; expected timestamp tx ty tz qx qy qz qw"),
    "vast-trajectory": invalid(" is larger than 512 MiB"),
    "compressed-trajectory": invalid(" is compressed; it must be plain text"),
    "link": without(),
    "fifo": without(),
    "folder": without(),
    "no-trajectory": without(
        "is missing or not a regular file; beside it: 'poses.txt' (an Algorithm says in output.trajectory "
        "where its poses are)"
    ),
    "nothing": without(),
    "empty-trajectory": lost("the algorithm wrote no pose", ""),
    "lost": lost("the algorithm wrote no pose", algorithm.NO_POSE),
    "elsewhere": lost(
        "no pose of the estimate, 1700000000.000 s to 1700000009.900 s, lies within 0.01 s of a ground-truth "
        "pose, 1600000000.000 s to 1600000010.000 s",
        algorithm.elsewhere(),
    ),
    "metrics-plain": measured(
        frames={"offered": 9, "processed": 8}, metrics=json.loads(algorithm.FLAT) | {"map": " voxels "}
    ),
    "metrics-nested": measured(metrics=json.loads(algorithm.NESTED)),
    "metrics-nothing": measured(),
    "metrics-lists": measured(f"{LEFT_OUT} a (a list), b.c (a list)", metrics={"b": {"d": 2}}),
    "metrics-infinite": measured(
        f"{LEFT_OUT} a (no finite number), b.c (no finite number), d (no finite number)", metrics={"e": 1}
    ),
    "metrics-large-number": measured(f"{LEFT_OUT} a (beyond 2^53)", metrics={"b": 2**53}),
    "metrics-100-keys": measured(
        f"{LEFT_OUT} k64 (more than 64 values), k65 (more than 64 values), "
        "k66 (more than 64 values) and 33 more",
        metrics={f"k{number:02}": number for number in range(64)},
    ),
    "metrics-long-texts": measured(
        f"{LEFT_OUT} k10 (more than 2 KiB), k11 (more than 2 KiB), k12 (more than 2 KiB) and 7 more",
        metrics={f"k{number}": "v" * 190 for number in range(10)} | {"last": 1},
    ),
    "metrics-long-name": measured(f"{LEFT_OUT} {'n' * 40}… {NAME_RULE}", metrics={"a": 2}),
    "metrics-terminal": measured(
        f"{LEFT_OUT} a�[31m {NAME_RULE}, b (a text must have one line of at most 200 printable characters), "
        f"c� {NAME_RULE} and 1 more",
        metrics={"e": 1},
    ),
    "metrics-deep": measured(f"{LEFT_OUT} a.a.a.a.a.a.a.a.a (nested deeper than 8)"),
    "metrics-no-object": measured(IGNORED),
    "metrics-half": measured(IGNORED),
    "metrics-brackets": measured(IGNORED),
    "metrics-too-large": measured(IGNORED),
}
"""Files that programs which end well leave as trajectory and metrics: reading it needs no executor."""

WRITING = {
    "kitti": measured(trajectory=KITTI_POSES, asked=KITTI_MODE),
    "kitti-lost": replace(lost("the algorithm wrote no pose", ""), asked=KITTI_MODE),
    "kitti-too-many": failed(
        "InvalidTrajectory",
        "output/poses/kitti.txt, line 101: frame 100 is beyond the recording, which has 100 frames, the "
        "first of them 0",
        asked=KITTI_MODE,
    ),
    "kitti-no-rotation": failed(
        "InvalidTrajectory",
        "output/poses/kitti.txt, line 51: its first three columns are no rotation: their rows must be "
        "orthonormal to 0.01, and right-handed",
        asked=KITTI_MODE,
    ),
    "kitti-as-tum": failed(
        "InvalidTrajectory",
        "output/poses/kitti.txt, line 1: found 8 of 12 values; expected the 3×4 pose matrix row by row, "
        "perhaps after the frame index",
        asked=KITTI_MODE,
    ),
    "kitti-in-the-way": failed(
        "InvalidTrajectory", "output/trajectory.txt can't be written: Is a directory", asked=KITTI_MODE
    ),
    **{
        name: failed(
            "NoTrajectory", "output/poses/kitti.txt is missing or not a regular file", asked=KITTI_MODE
        )
        for name in ("kitti-missing", "kitti-link", "kitti-fifo", "kitti-folder-is-a-link")
    },
    "euroc-inverted": measured(trajectory=EUROC_POSES, asked=EUROC_MODE),
    "euroc-in-seconds": failed(
        "InvalidTrajectory",
        "output/poses.csv, line 2: time stamp '1600000000.1' is no whole number of nanoseconds (seconds "
        "perhaps?)",
        asked=EUROC_MODE,
    ),
    "table-and-keyframes": measured(trajectory=TABLE_POSES, asked=TABLE_MODE, beside="table-and-keyframes"),
    "table-without-keyframes": measured(
        "output/KeyFrameTrajectory.txt is missing or not a regular file",
        trajectory=TABLE_POSES,
        asked=TABLE_MODE,
    ),
    "online": measured(beside="online"),
    "online-is-a-link": measured(beside="online-is-a-link"),
    "table-without-a-column": failed(
        "InvalidTrajectory",
        "output/table.csv, line 1: the first line has no column 'frame'; it names remark, time, px, py, pz, "
        "i, j, k, r",
        asked=TABLE_MODE,
    ),
}
"""Programs that write their poses in their own way, which is declared."""

LOCKED = {
    "phase": FAILED,
    "reason": "InvalidTrajectory",
    "message": "output/trajectory.txt: can't be read: Permission denied; "
    "usage.csv could not be put into RUN/run/output: Permission denied",
    "trajectory": None,
    "outcome": None,
}
HOSTILE = {
    "folder-as-samples": measured(
        differs=dict.fromkeys(
            ("process", "container"),
            Difference(
                "a workstation puts the samples beside the trajectory",
                {"message": "usage.csv could not be put into RUN/run/output: Is a directory"},
            ),
        )
    ),
    "output-is-a-link": without(),
    "removes-its-folder": without(),
    "folder-as-summary": measured(
        asked={"retries": 0},
        differs={
            "process": Difference(
                RIGHTS,
                {
                    "phase": FAILED,
                    "reason": "SystemFault",
                    "message": "the run can't be supervised: Is a directory: RUN/summary.json",
                    "trajectory": None,
                    "outcome": None,
                },
            )
        },
    ),
    "folder-as-process-record": measured(),
    "folders-1500-deep": measured(),
    "locked-folders": measured(),
    "locked-output": measured(
        # Nothing is closed to root.
        differs={"process": Difference(RIGHTS, LOCKED if os.geteuid() else {})}
    ),
}
"""Programs that leave what may be in the way of the next attempt."""

BEHAVIOURS = ENDING | LEAVING | WRITING | HOSTILE
STANDING_FOR = {
    "not-a-number": (
        "words",
        "unsorted",
        "garbage",
        "endless-line",
        "vast-trajectory",
        "compressed-trajectory",
    ),
    "link": ("fifo", "folder"),
    "nothing": ("no-trajectory",),
    "lost": ("empty-trajectory",),
    "metrics-nested": ("metrics-plain", "metrics-nothing", "metrics-lists", "metrics-deep"),
    "metrics-large-number": ("metrics-infinite",),
    "metrics-terminal": ("metrics-long-name",),
    "metrics-too-large": ("metrics-no-object", "metrics-half", "metrics-brackets"),
    "kitti-too-many": ("kitti-lost", "kitti-no-rotation", "kitti-as-tum", "kitti-in-the-way"),
    "kitti-folder-is-a-link": ("kitti-missing", "kitti-link", "kitti-fifo"),
    "euroc-inverted": ("euroc-in-seconds",),
    "table-and-keyframes": ("table-without-keyframes", "table-without-a-column"),
    "online": ("online-is-a-link",),
}
"""Behaviours that stand for others in containers: all of them end well and leave something of one sort, which
the same code reads on every executor. tests/monitor/test_contract.py has a pod's sidecar read each."""
SAMPLE = [
    name
    for name in BEHAVIOURS
    if os.environ.get("SLAMHIVE_EXAMPLES") == "thorough" or name not in {*chain(*STANDING_FOR.values())}
]
"""Behaviours that tests run in containers."""
AGAIN = ("well", "metrics-nested", "elsewhere", "crash-between-poses")
"""Behaviours of a second sweep, too: a run that succeeded is taken over, one that failed is done again."""


def study(
    executor: Executor, behaviours: Iterable[str] = BEHAVIOURS
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the Algorithm, the Sweep of the behaviours, and the one that asks for some of them again."""
    spec = {
        "version": "1",
        **executor.program((HERE / "algorithm.py").read_text(encoding="utf-8")),
        "modes": [
            {"name": "lidar", "roles": ["lidar"]},
            *({"name": mode, "roles": ["lidar"], "output": output} for mode, output in OWN_FILES.items()),
        ],
        "recording": ["Rosbag1"],
        "parameters": {"behaviour": {"type": "String", "default": "well", "values": [*BEHAVIOURS]}},
        "output": {"frame": "body"},
        "paces": ["Lockstep"],
        "deterministic": "Yes",
    }
    again = sweep("again", AGAIN)
    again["spec"]["cachePolicy"] = "Reuse"
    return _object("Algorithm", NAME, spec), sweep("behaviours", behaviours), again


def sweep(name: str, behaviours: Iterable[str]) -> dict[str, Any]:
    """Return a Sweep of some behaviours, which takes nothing over from any earlier one."""
    template = {
        "algorithmRef": {"name": NAME},
        "datasetRef": {"name": "tiny"},
        "sensors": "lidar",
        "retries": MACHINE_FAULTS,
        "timeout": "5m",
        "resources": {"cpu": "100m", "memory": "128Mi"},
    }
    chosen = [*behaviours]
    asked = [{BEHAVIOUR: one, **BEHAVIOURS[one].asked} for one in chosen if BEHAVIOURS[one].asked]
    matrix = [{"path": BEHAVIOUR, "values": chosen}]
    found = {"template": {"spec": template}, "matrix": matrix, "include": asked, "cachePolicy": "Rerun"}
    return _object("Sweep", name, found)


def _object(kind: str, name: str, spec: dict[str, Any]) -> dict[str, Any]:
    return {"apiVersion": "slamhive.io/v1alpha1", "kind": kind, "metadata": {"name": name}, "spec": spec}


def carry_out(executor: Executor, behaviours: Iterable[str] = BEHAVIOURS) -> dict[str, Row]:
    """Return an executor's outcomes of the behaviours; those of the second sweep are called `again: …`."""
    algorithm, first, second = study(executor, behaviours)
    found = outcomes(executor.run(algorithm, first), "behaviours", executor.faults("behaviours"))
    again = outcomes(executor.run(algorithm, second), "again", executor.faults("again"))
    return found | {f"again: {name}": row for name, row in again.items()}


def expected(executor: str, behaviours: Iterable[str] = BEHAVIOURS) -> dict[str, Row]:
    """Return the outcomes that an executor must make of them."""
    rows = {name: BEHAVIOURS[name].on(executor).columns() for name in behaviours}
    taken_over = {REUSED: True, "attempts": 0}
    again = {name: rows[name] | (taken_over if rows[name]["phase"] == SUCCEEDED else {}) for name in AGAIN}
    return rows | {f"again: {name}": row for name, row in again.items()}


def text(rows: Mapping[str, Row]) -> str:
    """Return outcomes for a person, in an order that two executors have in common."""
    lines = []
    for name in [name for name in expected("") if name in rows]:
        row = rows[name]
        lines.append(f"{name}")
        lines += [f"    {column} = {_shown(row[column])}" for column in sorted(row)]
    return "".join(f"{line}\n" for line in lines)


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else f"{value}"
