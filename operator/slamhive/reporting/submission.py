# SPDX-License-Identifier: Apache-2.0
"""Submissions to public challenges: one run's trajectory a sequence, in the archive that a challenge wants.

Forms: KITTI odometry: devkit, a file ``NN.txt`` with twelve numbers for each frame. Hilti 2022 and 2023: TUM
lines of the IMU, named as the bag; ``documentation/submissions/Format.md`` and ``evaluation-2023`` of
hilti-slam-challenge-2023, ``evaluation-2022`` of hilti-slam-challenge-2022.
"""

from __future__ import annotations

import re
import zipfile
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slamhive.analysis.measuring import read_estimate
from slamhive.analysis.subjects import Surroundings, pose_of_role, subject_of
from slamhive.contract.conversion import MachineFault, read_frames
from slamhive.contract.posefiles import FRAMES
from slamhive.local.running.evaluating import TrajectoryEvaluator
from slamhive.model.canonical import digest
from slamhive.model.errors import InputError, suggestion
from slamhive.model.sensors import Role, SensorMode
from slamhive_eval import EvaluationError, interpolate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from slamhive.data.making.preparation import Variant
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.results import RunRecord
    from slamhive_eval import Trajectory

_GAP_SECONDS = 1.0
_DATE = (1980, 1, 1, 0, 0, 0)
"""Of all files in an archive, so that equal runs give equal archives."""


class Pick(StrEnum):
    """Rules for choosing which of several repetitions is submitted."""

    FIRST = "first"
    BEST = "best"
    MEDIAN = "median"


@dataclass(frozen=True)
class Challenge:
    """Requirements of a SLAM challenge on a submission: its sequences, sensor of the poses and format.

    Attributes:
        sequences: names that its files have.
        role: sensor whose poses it wants.
        by_frames: whether it wants a 3×4 matrix for each frame, the first the identity; else TUM lines.
    """

    sequences: tuple[str, ...]
    role: Role
    by_frames: bool


CHALLENGES = {
    "kitti": Challenge(tuple(f"{number:02}" for number in range(11, 22)), Role.LEFT, by_frames=True),
    "hilti2022": Challenge(
        (
            "exp01_construction_ground_level",
            "exp02_construction_multilevel",
            "exp03_construction_stairs",
            "exp07_long_corridor",
            "exp09_cupola",
            "exp11_lower_gallery",
            "exp15_attic_to_upper_gallery",
            "exp21_outside_building",
        ),
        Role.IMU,
        by_frames=False,
    ),
    "hilti2023": Challenge(
        (
            *(f"site1_handheld_{number}" for number in range(1, 6)),
            *(f"site2_robot_{number}" for number in range(1, 4)),
            *(f"site3_handheld_{number}" for number in range(1, 5)),
        ),
        Role.IMU,
        by_frames=False,
    ),
}


class SubmissionFile(NamedTuple):
    """A file of a submission.

    Attributes:
        sequence: its name.
        record: the run that it is of.
        why: why this run of several.
        text: what it holds.
        poses: their number.
    """

    sequence: str
    record: RunRecord
    why: str
    text: str
    poses: int


def find_challenge(name: str) -> Challenge:
    """Return a challenge.

    Raises:
        InputError: none of that name whose form of submission is known.
    """
    if name not in CHALLENGES:
        known = ", ".join(CHALLENGES)
        raise InputError(f"unknown challenge {name!r}{suggestion(name, CHALLENGES)}; known: {known}")
    return CHALLENGES[name]


def by_sequence(
    challenge: Challenge, records: Sequence[RunRecord], names: Mapping[str, str]
) -> dict[str, list[RunRecord]]:
    """Return runs by the sequence that their dataset is of.

    Args:
        challenge: the challenge.
        records: runs of one configuration.
        names: sequences by dataset, where the dataset's own name doesn't say it.

    Raises:
        InputError: a dataset's sequence isn't known, runs of two datasets or of two configurations.
    """
    found: dict[str, list[RunRecord]] = {}
    for record in records:
        dataset = str(record.spec["datasetRef"]["name"])
        sequence = names.get(dataset) or _sequence_of(challenge, dataset)
        others = {str(one.spec["datasetRef"]["name"]) for one in found.get(sequence, [])}
        if others - {dataset}:
            raise InputError(f"{dataset} and {', '.join(others)} are both sequence {sequence}: leave out one")
        found.setdefault(sequence, []).append(record)
    _require_one_configuration(records)
    return dict(sorted(found.items()))


def _sequence_of(challenge: Challenge, dataset: str) -> str:
    """Return the sequence that ends a dataset's name: kitti-11, hilti2023-site1-handheld-1."""
    plain = _plain(dataset)
    for sequence in challenge.sequences:
        if plain == _plain(sequence) or plain.endswith(f"-{_plain(sequence)}"):
            return sequence
    raise InputError(
        f"which sequence is the dataset {dataset!r}? Say it by --name {dataset}=SEQUENCE; sequences: "
        f"{', '.join(challenge.sequences)}"
    )


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", name.lower())


def _require_one_configuration(records: Sequence[RunRecord]) -> None:
    apart = ("datasetRef", "repetition", "seed")
    # Repetitions and seeds differ by intention: which of them is submitted is what `choose_run` decides.
    kinds: dict[str, RunRecord] = {}
    for record in records:
        kept = {key: value for key, value in record.spec.items() if key not in apart}
        kinds.setdefault(digest(kept), record)
    if len(kinds) > 1:
        first, second = list(kinds.values())[:2]
        differ = sorted(
            key for key in first.spec if key not in apart and first.spec[key] != second.spec.get(key)
        )
        raise InputError(
            f"the runs are of {len(kinds)} configurations, and a submission is of one: {first.name} and "
            f"{second.name} differ in {', '.join(differ)}; choose by --algorithm or --where"
        )


def choose_run(records: Sequence[RunRecord], pick: Pick) -> tuple[RunRecord, str]:
    """Return one of the repetitions on a sequence, and why.

    Raises:
        InputError: it is to be chosen by error, and one was not measured.
    """
    ordered = sorted(records, key=lambda one: (one.spec.get("repetition") or 0, one.name))
    if len(ordered) == 1:
        return ordered[0], "the only run"
    if pick is Pick.FIRST:
        return ordered[0], f"the first of {len(ordered)} repetitions"
    errors = {one.uid: _error(one) for one in ordered}
    without = [one.name for one in ordered if errors[one.uid] is None]
    if without:
        raise InputError(
            f"{without[0]} has no ATE to choose by; without public ground truth, take --repetition first",
            f"repetition {pick}",
        )
    ranked = sorted(ordered, key=lambda one: errors[one.uid] or 0.0)
    # Of an even number the lower one of the two in the middle: what is submitted is a run, not a mean.
    place = 0 if pick is Pick.BEST else (len(ranked) - 1) // 2
    what = "the least" if pick is Pick.BEST else "the median"
    return ranked[place], f"{what} ATE of {len(ranked)} repetitions, {errors[ranked[place].uid]:.4g} m"


def _error(record: RunRecord) -> float | None:
    for result in record.results:
        value = (result.values.get("ate") or {}).get("rmse")
        if value is not None:
            return float(value)
    return None


def make_entry(
    bench: Workbench, challenge: Challenge, sequence: str, records: Sequence[RunRecord], pick: Pick
) -> SubmissionFile:
    """Return a sequence's file, made of one of the runs on it.

    Raises:
        InputError: the run's trajectory is gone or can't be used, or lacks a frame.
    """
    record, why = choose_run(records, pick)
    path = TrajectoryEvaluator(bench).trajectory_of(record)
    if path is None:
        raise InputError(f"{sequence}: the trajectory of {record.name} is gone; run it again")
    try:
        estimate = read_estimate(path)
    except EvaluationError as error:
        raise InputError(f"{sequence}: {error}") from None
    if estimate is None:
        raise InputError(f"{sequence}: {record.name} wrote no pose")
    algorithm = bench.workshop.algorithm(record.spec["algorithmRef"]["name"]).algorithm
    variant = bench.prepare(record.spec, algorithm)
    poses = estimate.moved(_mount(bench, challenge, record, variant))
    if challenge.by_frames:
        poses = _at_frames(poses, variant, f"{sequence}: {record.name}")
    return SubmissionFile(sequence, record, why, _text(poses, by_frames=challenge.by_frames), len(poses))


def _mount(
    bench: Workbench, challenge: Challenge, record: RunRecord, variant: Variant
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the pose of the challenge's sensor in the frame of the estimate, (4, 4)."""
    spec = record.spec
    dataset = bench.dataset(spec["datasetRef"]["name"]).dataset.spec
    given = Surroundings(
        truth_frame=np.eye(4),
        by_role={role: sensor.T_body_sensor for role, sensor in variant.sensors.items()},
        by_name={name: sensor.T_body_sensor for name, sensor in dataset.sensors.items()}
        | {view.name: view.T_body_sensor for view in variant.sensors.values()},
        remap=spec["input"].get("remap"),
    )
    algorithm = bench.workshop.algorithm(spec["algorithmRef"]["name"]).algorithm
    body_estimate = subject_of(algorithm.spec, SensorMode(spec["sensors"]), given).extrinsic
    body_sensor = np.asarray(pose_of_role(challenge.role, given), dtype=np.float64)
    mount: np.ndarray[Any, np.dtype[np.float64]] = np.linalg.inv(np.asarray(body_estimate)) @ body_sensor
    return mount


def _at_frames(poses: Trajectory, variant: Variant, where: str) -> Trajectory:
    """Return the pose of each frame, in the frame of the first.

    Raises:
        InputError: a frame has none.
    """
    try:
        stamps = np.array(read_frames(str(variant.path.parent / FRAMES)), dtype=np.float64) / 1e9
    except MachineFault as error:
        raise InputError(f"{where}: {error}") from None
    found, positions, quaternions = interpolate(poses, stamps, _GAP_SECONDS)
    # Programs round the times of their poses: a frame up to 10 ms outside takes the pose at the end.
    edge = ~found & (np.abs(stamps - np.clip(stamps, poses.stamps[0], poses.stamps[-1])) <= 0.01)
    for place in np.flatnonzero(edge):
        nearest = 0 if stamps[place] <= poses.stamps[0] else -1
        positions[place], quaternions[place] = poses.positions[nearest], poses.quaternions[nearest]
    missing = np.flatnonzero(~(found | edge))
    if missing.size:
        raise InputError(
            f"{where}: {missing.size} of {len(stamps)} frames have no pose, the first is frame {missing[0]}; "
            "the challenge wants one for each"
        )
    made = type(poses)(stamps, positions, quaternions)
    # KITTI counts from the first frame's camera: its first pose is the identity.
    turn = made.matrices[0].T
    return made.transformed(turn, -turn @ made.positions[0])


def _text(poses: Trajectory, *, by_frames: bool) -> str:
    if by_frames:
        matrices = np.concatenate((poses.matrices, poses.positions[:, :, np.newaxis]), axis=2)
        rows = matrices.reshape(-1, 12).tolist()
        return "".join(" ".join(f"{number:.9e}" for number in row) + "\n" for row in rows)
    table = np.column_stack((poses.stamps, poses.positions, poses.quaternions)).tolist()
    lines = [" ".join(map(repr, row)) for row in table]
    return "\n".join(["# timestamp_s tx ty tz qx qy qz qw", *lines, ""])


def missing_sequences(challenge: Challenge, found: Sequence[str]) -> list[str]:
    """Return the sequences that a challenge wants and nothing is there of."""
    return [name for name in challenge.sequences if name not in found]


def write_archive(path: Path, entries: Sequence[SubmissionFile]) -> None:
    """Write the archive, the same bytes for the same runs.

    Raises:
        InputError: it is there already.
        OSError: the disk refuses.
    """
    if path.exists():
        raise InputError(f"{path}: exists already", "output")
    aside = path.with_name(f".{path.name}.part")
    try:
        with zipfile.ZipFile(aside, "w", zipfile.ZIP_DEFLATED) as archive:
            for entry in entries:
                info = zipfile.ZipInfo(f"{entry.sequence}.txt", _DATE)
                info.compress_type = zipfile.ZIP_DEFLATED
                info.external_attr = 0o644 << 16
                archive.writestr(info, entry.text)
        aside.rename(path)
    finally:
        aside.unlink(missing_ok=True)
