# SPDX-License-Identifier: Apache-2.0
"""CPU seconds and peak memory of slamhive-eval beside evo 1.38.1, which gets an environment of its own.

Both measure the same files on the same machine in the same run. "In process" counts from after the imports,
reading the files included; "as a command" counts everything.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path
from typing import Any, NamedTuple

EVO = "evo==1.38.1"
SHARED = Path(__file__).parents[3] / "shared" / "data" / "icra2023"
COMMAND_POSES, LIBRARY_POSES, MANY_POSES = 3_000, 100_000, 1_000_000
REPETITIONS, PEER_REPETITIONS = 5, 2
NINE_DECIMALS = "%.9f"
"""Format of most SLAM programs."""
ALL_DIGITS = "%.17g"
"""Format of all digits that float64 holds."""

MAKE = """
import sys
import numpy as np
from slamhive_eval import Trajectory, rotation

poses, form = int(sys.argv[1]), sys.argv[2]
rng = np.random.default_rng(poses)
t = np.arange(poses) / 20.0
rpy = np.column_stack((0.1 * np.sin(t), 0.1 * np.cos(0.7 * t), 0.3 * t + np.sin(0.2 * t)))
heading = np.column_stack((np.cos(rpy[:, 2]), np.sin(rpy[:, 2]), 0.1 * np.sin(0.3 * t)))
positions = np.cumsum(0.03 * heading, axis=0)
truth = Trajectory(1.6e9 + t, positions, rotation.from_roll_pitch_yaw(rpy))
turn = rotation.to_matrix(rotation.from_roll_pitch_yaw(np.array([[0.1, 0.2, 1.0]])))[0]
noisy = Trajectory(
    truth.stamps + 0.001,
    positions + rng.normal(0, 0.01, positions.shape),
    truth.quaternions + rng.normal(0, 0.002, (poses, 4)),
).transformed(turn, np.array((1.0, 2.0, 3.0)))
row = " ".join([form] * 8) + "\\n"
for file, one in zip(sys.argv[3:], (truth, noisy)):
    with open(file, "w") as out:
        out.writelines(row % tuple(v) for v in np.column_stack((one.stamps, one.positions, one.quaternions)))
"""

OURS = """
import json, sys, time
from slamhive_eval import align, ape_errors, find_pairs, match, read_trajectory, rpe_errors
work, *files = sys.argv[1:]
start = time.process_time()

def rmse(errors):
    return float((errors**2).mean() ** 0.5)

if work == "runs":
    truths, out = {}, []
    for name, estimate in json.load(open(files[0])):
        if name not in truths:
            truths[name] = read_trajectory(name)
        truth, estimate = match(truths[name], read_trajectory(estimate))
        sim3, se3 = (align(truth, estimate, method).apply(estimate) for method in ("sim3", "se3"))
        pairs = find_pairs(sim3, 1.0, "m", all_pairs=True)
        errors = ape_errors(truth, sim3), ape_errors(truth, se3), rpe_errors(truth, sim3, pairs)
        out += map(rmse, errors)
else:
    truth, estimate = match(*map(read_trajectory, files))
    estimate = align(truth, estimate, "se3").apply(estimate)
    if work == "rpe":
        pairs = find_pairs(estimate, 1.0, "m", all_pairs=True)
        errors = rpe_errors(truth, estimate, pairs)
    else:
        errors = ape_errors(truth, estimate, "angle_deg" if work == "angle" else "trans_part")
    out = [rmse(errors)]
print(json.dumps({"cpu": time.process_time() - start, "result": out}))
"""

PEER = """
import copy, json, sys, time
from evo.core import metrics, sync
from evo.core.metrics import PoseRelation, Unit
from evo.tools import file_interface
work, *files = sys.argv[1:]
start = time.process_time()

def load(*names):
    return [file_interface.read_tum_trajectory_file(name) for name in names]

def rmse(metric, truth, estimate):
    metric.process_data((truth, estimate))
    return metric.get_statistic(metrics.StatisticsType.rmse)

def rpe():
    return metrics.RPE(PoseRelation.translation_part, 1.0, Unit.meters, all_pairs=True)

if work == "runs":
    truths, out = {}, []
    for name, estimate in json.load(open(files[0])):
        if name not in truths:
            truths[name] = load(name)[0]
        truth, estimate = sync.associate_trajectories(truths[name], load(estimate)[0])
        sim3 = copy.deepcopy(estimate)
        sim3.align(truth, correct_scale=True)
        estimate.align(truth)
        ape = metrics.APE(PoseRelation.translation_part)
        out += [rmse(ape, truth, sim3), rmse(ape, truth, estimate), rmse(rpe(), truth, sim3)]
else:
    truth, estimate = sync.associate_trajectories(*load(*files))
    estimate.align(truth)
    relation = PoseRelation.rotation_angle_deg if work == "angle" else PoseRelation.translation_part
    out = [rmse(rpe() if work == "rpe" else metrics.APE(relation), truth, estimate)]
print(json.dumps({"cpu": time.process_time() - start, "result": out}))
"""


class Cost(NamedTuple):
    """CPU seconds, peak memory in MB and printed result of a process."""

    cpu: float
    megabytes: float
    result: Any


def run(words: list[str], home: Path, repetitions: int = 1) -> Cost:
    """Run a command so many times; the least CPU time, which other programs disturb least."""
    environment = os.environ | {"HOME": str(home), "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"}
    costs = []
    for _ in range(repetitions):
        with tempfile.TemporaryFile("w+") as out:
            process = subprocess.Popen(words, stdout=out, stderr=subprocess.STDOUT, env=environment)
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            out.seek(0)
            text = out.read()
        if process.returncode:
            raise RuntimeError(f"{' '.join(words[:3])}: exit code {process.returncode}: {text[-300:]}")
        last = text.strip().splitlines()[-1] if text.strip() else ""
        inside = json.loads(last) if last.startswith("{") else {}
        cpu = inside.get("cpu", usage.ru_utime + usage.ru_stime)
        costs.append(Cost(cpu, usage.ru_maxrss / 1024, inside.get("result")))
    return min(costs, key=lambda cost: cost.cpu)


def peer_python() -> Path | None:
    """The interpreter of an environment with evo, made when it isn't there; None where uv can't."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "slamhive-bench" / EVO.replace("==", "-")
    python = folder / "bin" / "python"
    works = python.exists() and not subprocess.run([python, "-c", "import evo"], check=False).returncode
    if not works:
        try:
            venv.create(folder, clear=True)
            words = ["pip", "install", "--quiet", "--python", python, EVO]
            subprocess.run([Path(sys.prefix) / "bin" / "uv", *words], check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            return None
    return python


def make_files(folder: Path, poses: int, form: str = NINE_DECIMALS) -> list[str]:
    """A smooth path of a body that turns, and a noisy, moved estimate of it.

    A process of its own makes them: what a process takes is never reported as less than its parent holds.
    """
    files = [str(folder / f"{name}-{poses}.txt") for name in ("truth", "estimate")]
    subprocess.run([sys.executable, "-c", MAKE, str(poses), form, *files], check=True)
    return files


def agree(ours: list[float], theirs: list[float]) -> str:
    """Return a warning where numbers are not the same to 1e-9, empty where they are."""
    same = all(math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12) for a, b in zip(ours, theirs, strict=True))
    return "" if same else ", RESULTS DIFFER"


def report(what: str, ours: Cost, peer: Cost | None, share: int) -> None:
    """Print one row: ours and evo's CPU seconds and memory, and the share reached."""
    beside = f"at most 1/{share} of evo; evo not installable"
    if peer is not None:
        reached = peer.cpu / ours.cpu
        missed = "" if reached >= share else ", TOO MUCH"
        if ours.result is not None:
            missed += agree(ours.result, peer.result)
        beside = f"evo {peer.cpu:.2f} s, {peer.megabytes:.0f} MB: 1/{reached:.1f}, at most 1/{share}{missed}"
    print(f"{what} · {ours.cpu:.3f} s, {ours.megabytes:.0f} MB · {beside}", flush=True)


def bench_commands(folder: Path, peer: Path | None) -> None:
    """Time both as commands."""
    files = make_files(folder, COMMAND_POSES)
    command = [sys.executable, "-m", "slamhive_eval.command"]
    for what, ours, theirs in (
        ("ape", ["ape", *files, "--align", "se3"], ["evo_ape", "tum", *files, "-a"]),
        (
            "rpe, 1 m, all pairs",
            ["rpe", *files, "--align", "se3", "--delta", "1", "--unit", "m", "--all-pairs"],
            ["evo_rpe", "tum", *files, "-a", "-d", "1", "-u", "m", "--all_pairs"],
        ),
    ):
        found = run([*command, *ours], folder, REPETITIONS)
        beside = None
        if peer is not None:
            beside = run([str(peer.parent / theirs[0]), *theirs[1:]], folder, REPETITIONS)
        report(f"{what} of {COMMAND_POSES:,} poses, as a command", found, beside, 3)


def bench_library(folder: Path, peer: Path | None) -> None:
    """Time both in process."""
    for form, digits in ((NINE_DECIMALS, ""), (ALL_DIGITS, ", 17 digits")):
        files = make_files(folder, LIBRARY_POSES, form)
        for what, work, share in (
            ("APE, SE(3)", "ape", 10),
            ("APE, rotation angle", "angle", 50),
            ("RPE, 1 m, all pairs", "rpe", 10),
        ):
            found = run([sys.executable, "-c", OURS, work, *files], folder, REPETITIONS)
            beside = None
            if peer is not None:
                beside = run([str(peer), "-c", PEER, work, *files], folder, PEER_REPETITIONS)
            report(f"{what}, {LIBRARY_POSES:,} poses{digits}, in process", found, beside, share)


def bench_runs(folder: Path, peer: Path | None) -> None:
    """Time both over real runs, where they are."""
    reference = SHARED / "reference.json"
    if not reference.exists():
        print("the 81 runs of the paper · their files aren't here · ")
        return
    runs = json.loads(reference.read_text())["runs"]
    files = [(f"groundtruth/{run['dataset']}.txt", f"runs/{run['id']:03}/traj.txt") for run in runs]
    pairs = folder / "pairs.json"
    pairs.write_text(json.dumps([[str(SHARED / file) for file in pair] for pair in files]))
    found = run([sys.executable, "-c", OURS, "runs", str(pairs)], folder, REPETITIONS)
    beside = run([str(peer), "-c", PEER, "runs", str(pairs)], folder) if peer is not None else None
    report(f"{len(runs)} real runs: ATE by sim3 and se3, RPE 1 m all pairs", found, beside, 15)
    listed = folder / "pairs.txt"
    listed.write_text("".join(f"'{SHARED / truth}' '{SHARED / estimate}'\n" for truth, estimate in files))
    words = ["batch", str(listed), "--align", "sim3", "se3", "--delta", "1", "--unit", "m", "--all-pairs"]
    started = time.perf_counter()
    found = run([sys.executable, "-m", "slamhive_eval.command", *words], folder)
    wall = time.perf_counter() - started
    what = "the same by batch, as a command, with coverage, outcome and rotations"
    print(f"{what} · {found.cpu:.2f} s, {wall:.2f} s wall · ", flush=True)


def bench_many(folder: Path) -> None:
    """Measure how time and memory grow to a million poses."""
    costs = []
    for poses in (MANY_POSES // 4, MANY_POSES):
        files = make_files(folder, poses)
        costs.append(run([sys.executable, "-c", OURS, "ape", *files], folder))
        for file in files:
            Path(file).unlink()
    small, large = costs
    growth = large.cpu / small.cpu
    too_much = "" if large.megabytes < 1000 and growth < 5 else ", TOO MUCH"
    print(
        f"APE, SE(3), {MANY_POSES:,} poses, in process · {large.cpu:.2f} s, {large.megabytes:.0f} MB · "
        f"limit 1000 MB and linear: {growth:.1f} times as long as a quarter of them{too_much}",
        flush=True,
    )


def main() -> int:
    """Print each figure beside evo's."""
    peer = peer_python()
    if peer is None:
        print("evo not installable · ours alone · ", flush=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench_commands(folder, peer)
        bench_library(folder, peer)
        bench_runs(folder, peer)
        bench_many(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
