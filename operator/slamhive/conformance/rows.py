# SPDX-License-Identifier: Apache-2.0
"""Judgement of what came of starts: each function looks at one thing. Pure; nothing is started here."""

from __future__ import annotations

import signal
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from slamhive.conformance.findings import Finding, failed, passed, skipped, warned
from slamhive.conformance.readings import MANY_DROPPED, TOO_SLOW
from slamhive.model.algorithm import Poses
from slamhive.model.results import Phase, Reason, remark_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.conformance.executors import CheckEnd
    from slamhive.model.algorithm import AlgorithmSpec, Output
    from slamhive.model.results import RunRecord
    from slamhive_eval import Trajectory

_TAKEN_IN = 0.98
"""The share of the frames that have to be accounted for."""
_PROCESSED = 0.5
_END_SHARE, _END_SECONDS = 0.1, 1.0
"""The last pose may be this much before the end of the recording."""
_STILL_METRES, _STILL_RADIANS = 0.05, 0.03
"""A platform at rest keeps within these of where it ends: less gives no new keyframe."""
_EQUAL = 1e-9
_MIB = 1 << 20

_MEND = "mend what it names: runs that are counted say it each time"

_WHAT_HELPS = {
    Reason.DEADLINE_EXCEEDED: "see where it waits; --timeout gives it longer",
    Reason.OUT_OF_MEMORY: "a run has 4Gi unless it asks for more: keep less of the map, or read as you go",
    Reason.INVALID_PARAMETERS: "mend the template: slamhive algorithm render shows what it gives",
    Reason.NO_TRAJECTORY: "write output/trajectory.txt, or declare output.trajectory with the file's path",
    Reason.INVALID_TRAJECTORY: "write what output.trajectory declares, or TUM format into trajectory.txt",
    Reason.OUTPUT_TOO_LARGE: "write less into output/",
    Reason.ALGORITHM_UNAVAILABLE: "have this machine offer what it names",
    Reason.PREPARATION_FAILED: "give a dataset that has the sensors of the mode: --dataset",
    Reason.IMAGE_PULL_FAILED: "push the image to where the cluster pulls from, or name another: --image",
    Reason.ALGORITHM_FAILED: "end with exit code 0 when the program ran, tracked or not",
}


def ran(ended: Sequence[CheckEnd]) -> Finding:
    """Say whether all starts ended well."""
    bad = [one.record for one in ended if one.record.phase is not Phase.SUCCEEDED]
    if not bad:
        told = f"{len(ended)} of {len(ended)} ended well"
        remark = next(filter(None, (_remark(one.record) for one in ended)), "")
        return warned("runs", f"{told}; {remark}", _MEND) if remark else passed("runs", told)
    first = bad[0]
    how = _WHAT_HELPS.get(first.reason, "") if first.reason else ""
    told = f"{len(bad)} of {len(ended)} failed: {first.reason}: {first.message}"
    return failed("runs", told, how or "try it again; it is the machine's fault, not the algorithm's")


def _remark(record: RunRecord) -> str:
    """Return the remark on a run that ended well, without that on its load."""
    doubt = remark_of(record.usage, None) or ""
    return (record.message or "").removeprefix(doubt).removeprefix("; ")


def settings(spec: AlgorithmSpec, ended: CheckEnd) -> Finding | None:
    """Say whether the settings files were rendered, and opened by the program; None where there are none."""
    if not spec.files:
        return None
    wanted = [file.path for file in spec.files]
    if not ended.settings:
        return skipped("settings", f"{', '.join(wanted)}: what was rendered isn't kept by this executor")
    missing = [path for path in wanted if path not in ended.settings]
    unread = [path for path in wanted if ended.settings.get(path) is False]
    if missing:
        return failed("settings", f"not rendered: {', '.join(missing)}", "see the run's message")
    if unread:
        how = "give the program the path: files/… in its working folder, or $SLAMHIVE_FILES"
        if spec.ros2 is not None and spec.ros2.parameters is None:
            how = "name it in ros2.parameters, with arguments: Ros, if it is a file of parameters"
        return failed("settings", f"rendered, but nothing opened {', '.join(unread)}", how)
    if any(ended.settings[path] is None for path in wanted):
        return passed("settings", f"rendered: {', '.join(wanted)}; whether it was read can't be told here")
    return passed("settings", f"rendered and opened: {', '.join(wanted)}")


def data(
    frames: int, end: float, seconds: float, output: Output, ended: CheckEnd, *, rest: float = 0.0
) -> Finding:
    """Say whether the recording was read to its end.

    Args:
        frames: how many frames it has.
        end: sensor time of the last one, s.
        seconds: its length.
        rest: for how long the platform doesn't move at its end, s: no keyframes come of that.
        output: what the poses mean.
        ended: what came of a start.
    """
    counted = ended.record.frames
    if counted is not None and counted.processed is not None:
        taken = counted.processed + (counted.dropped or 0)
        told = f"{counted.processed} of {frames} frames processed, {counted.dropped or 0} dropped"
        if taken < _TAKEN_IN * frames:
            how = "read until the recording ends; count what is left out as framesDropped in metrics.json"
            return failed("data", f"{told}: {frames - taken} are not accounted for", how)
        if counted.processed < _PROCESSED * frames:
            return warned("data", told, "most frames are left out: is it too slow, or are they refused?")
        if (counted.dropped or 0) > MANY_DROPPED * frames:
            return warned("data", told, TOO_SLOW)
        return passed("data", told)
    return _data_by_poses(end, seconds, rest, output, ended.trajectory)


def _data_by_poses(
    end: float, seconds: float, rest: float, output: Output, trajectory: Trajectory | None
) -> Finding:
    if trajectory is None:
        return warned("data", "without a pose nothing tells how far it read", "write metrics.json")
    gap = end - float(trajectory.stamps[-1])
    of_keyframes = output.poses is Poses.KEYFRAMES
    what = "keyframes" if of_keyframes else "poses"
    told = f"{len(trajectory.stamps)} {what}, the last {max(gap, 0.0):.2f} s before the end of the data"
    if of_keyframes and rest > 0:
        told += f", where nothing moves for {rest:.2f} s"
        gap -= rest
    if gap <= max(_END_SECONDS, _END_SHARE * seconds):
        return passed("data", told)
    if of_keyframes:
        return warned("data", told, "look into its log whether it was still tracking: keyframes don't tell")
    return failed("data", told, "read until the recording ends, and write framesProcessed into metrics.json")


def rest_before(end: float, truth: Trajectory) -> float:
    """Return for how long before an instant nothing moves any more, s.

    Args:
        end: the instant, in sensor time, s.
        truth: ground truth.
    """
    before = truth.stamps <= end
    if not before.any():
        return 0.0
    positions, quaternions = truth.positions[before], truth.quaternions[before]
    moved = np.linalg.norm(positions - positions[-1], axis=1) > _STILL_METRES
    turned = 2 * np.arccos(np.clip(np.abs(quaternions @ quaternions[-1]), 0.0, 1.0)) > _STILL_RADIANS
    moving = np.flatnonzero(moved | turned)
    begin = moving[-1] if len(moving) else 0
    return max(end - float(truth.stamps[before][begin]), 0.0)


def repeatable(declared: str, ended: Sequence[CheckEnd]) -> Finding:
    """Say whether equal starts gave equal trajectories, and whether that is what is declared."""
    check, count = "determinism", len(ended)
    written = {one.record.trajectory.sha256 if one.record.trajectory else None for one in ended}
    absent = next((one.absent for one in ended if one.absent), "")
    if len(written) == 1:
        told, equal = f"{count} runs are equal to the byte", True
    elif absent:
        told, equal = f"differ; by how much can't be told: {absent}", False
    else:
        told, equal = difference([one.trajectory for one in ended])
        told = f"{count} runs {told}"
    told = f"declared {declared}; {told}"
    if declared == "Yes":
        if equal:
            return passed(check, told)
        how = 'declare deterministic: "No" or Unknown, or fix its seed, its threads and what it drops by time'
        return failed(check, told, how)
    if declared == "No" and not equal:
        return passed(check, told)
    if declared == "No":
        return passed(check, told, "others may differ")
    return warned(check, told, f'declare deterministic: "{"Yes" if equal else "No"}"')


def difference(trajectories: Sequence[Trajectory | None]) -> tuple[str, bool]:
    """Say how much trajectories differ, and whether that is nothing."""
    known = [one for one in trajectories if one is not None]
    if len(known) < len(trajectories):
        return "differ: not all of them have poses", False
    counts = [len(one.stamps) for one in known]
    if len(set(counts)) > 1:
        return f"differ: they have {', '.join(map(str, counts))} poses", False
    first = known[0]
    if any(not np.array_equal(one.stamps, first.stamps) for one in known):
        return "differ in their stamps", False
    apart = max(float(np.abs(one.positions - first.positions).max()) for one in known)
    turned = max(float(np.abs(one.quaternions - first.quaternions).max()) for one in known)
    if max(apart, turned) <= _EQUAL:
        return f"are equal to {_EQUAL:g}, not to the byte", True
    return f"differ by up to {apart:.3g} m", False


def refusal(what: str, ended: CheckEnd, timeout: float) -> Finding:  # noqa: PLR0911 - a line a case
    """Say whether the program ends with a sentence when its recording lacks what it needs.

    Args:
        what: what was looked at.
        ended: what came of the start.
        timeout: how long it had, s.
    """
    record = ended.record
    how = "end with an exit code other than 0, and one sentence on standard error"
    match record.reason:
        case Reason.DEADLINE_EXCEEDED:
            return failed(what, f"it still waited after {timeout:.0f} s", f"don't wait for ever: {how}")
        case Reason.OUT_OF_MEMORY | Reason.OUTPUT_TOO_LARGE:
            return failed(what, f"{record.reason}: {record.message}", how)
        case Reason.NO_TRAJECTORY | Reason.INVALID_TRAJECTORY:
            return warned(what, f"exit code 0, and {record.reason}: {record.message}", how)
        case Reason.ALGORITHM_FAILED if ended.signal is not None:
            return failed(what, f"it crashed: {record.message}", how)
        case Reason.ALGORITHM_FAILED:
            if record.message and ": " in record.message:
                return passed(what, f"it ends: {record.message}")
            return warned(what, f"it ends without a sentence: {record.message}", how)
        case None if record.phase is Phase.SUCCEEDED:
            poses = record.trajectory.poses if record.trajectory else 0
            told = f"it ended as if nothing were missing, with {poses} poses"
            return warned(what, told, f"if it can't do without, {how}")
    return skipped(what, f"{record.reason}: {record.message}")


def stopped(ended: CheckEnd) -> Finding | None:
    """Say what the program does with SIGTERM; None where it had ended before."""
    check, record = "SIGTERM", ended.record
    if record.phase is Phase.SUCCEEDED:
        return None
    if record.phase is not Phase.CANCELLED:
        return skipped(check, f"it ended before: {record.reason}: {record.message}")
    poses = record.trajectory.poses if record.trajectory else 0
    kept = f"{poses} poses kept" if poses else "no poses kept"
    took = f" after {ended.stop_seconds:.1f} s" if ended.stop_seconds is not None else ""
    if ended.signal == signal.SIGKILL:
        how = "handle SIGTERM, or leave it at its default: after 5 s the whole run is killed"
        return failed(check, f"it did not end, and was killed{took}; {kept}", how)
    if ended.exit_code is None and ended.signal is None:
        return passed(check, f"it ended{took}; {kept}")
    by = f"exit code {ended.exit_code}" if ended.signal is None else signal.Signals(ended.signal).name
    if ended.signal not in {None, signal.SIGTERM}:
        return warned(check, f"it crashed{took} ({by}); {kept}", "its handler of SIGTERM has a fault")
    return passed(check, f"it ended{took} ({by}); {kept}")


def cost(seconds: float, ended: Sequence[CheckEnd]) -> Finding:
    """Tell time and memory, and whether anything speaks against the figures."""
    check = "time and memory"
    records = [one.record for one in ended]
    walls = [one.usage.wall_seconds for one in records if one.usage and one.usage.wall_seconds is not None]
    cpus = [one.usage.cpu.seconds for one in records if one.usage and one.usage.cpu.seconds is not None]
    peaks = [one.usage.memory.peak_bytes for one in records if one.usage and one.usage.memory.peak_bytes]
    if not walls or not cpus or not peaks:
        return warned(check, "this executor doesn't tell them")
    cpu = median(cpus)
    told = (
        f"{median(walls):.2f} s, {cpu:.2f} CPU s ({cpu / seconds:.2f} a second of data), "
        f"{max(peaks) / _MIB:.0f} MiB"
    )
    doubts = sorted({one.usage.suspect for one in records if one.usage and one.usage.suspect})
    if doubts:
        return warned(
            check, f"{told}; UsageSuspect: {doubts[0]}", "see what metrics.json claims for the reader"
        )
    if any(one.usage and one.usage.includes_reader for one in records):
        return passed(check, f"{told}; the reading of the recording is in it")
    if any(one.usage and one.usage.includes_reader is None for one in records):
        how = "read on a thread of its own and write its clock as readerCpuSeconds into metrics.json, or "
        how += "say includesReader: true; without that its CPU is marked beside others'"
        return warned(check, f"{told}; whether the reading of the recording is in it isn't known", how)
    return passed(check, told)
