# SPDX-License-Identifier: Apache-2.0
"""Covariances from tables and bags, carried through alignment, to ``slamhive-eval consistency``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from slamhive_eval import Trajectory, read_trajectory, rotation, write_tum
from slamhive_eval.command import main

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

AXES = ("x", "y", "z", "roll", "pitch", "yaw")
TURN = rotation.to_matrix(rotation.from_roll_pitch_yaw(np.array([[0.0, 0.0, 2.0]])))[0]


@pytest.fixture(name="truth")
def truth_fixture(tmp_path: Path, wander: Callable[..., Trajectory]) -> Trajectory:
    truth = wander(3000, seed=3)
    write_tum(tmp_path / "gt.txt", truth)
    return truth


@pytest.fixture(name="estimate")
def estimate_fixture(truth: Trajectory) -> Trajectory:
    """Errors drawn from correlated covariances, in a world turned about z."""
    rng = np.random.default_rng(5)
    mixed = np.eye(6) + rng.uniform(-0.3, 0.3, (6, 6))
    root = mixed * np.array([0.03, 0.02, 0.05, 0.01, 0.02, 0.005])[:, np.newaxis]
    scale = rng.uniform(0.5, 2.0, len(truth))
    covariances = scale[:, np.newaxis, np.newaxis] ** 2 * (root @ root.T)
    errors = scale[:, np.newaxis] * (rng.normal(0, 1, (len(truth), 6)) @ root.T)
    half = errors[:, 3:] / 2.0
    turns = rotation.normalize(np.column_stack((half, np.sqrt(1.0 - np.sum(half * half, axis=1)))))
    noisy = Trajectory(
        truth.stamps,
        truth.positions + errors[:, :3],
        rotation.multiply(turns, truth.quaternions),
        covariances=covariances,
    )
    return noisy.transformed(TURN, np.array((3.0, 2.0, 1.0)))


def table(estimate: Trajectory, names: list[str], columns: np.ndarray, separator: str) -> str:
    poses = np.column_stack((estimate.stamps, estimate.positions, estimate.quaternions, columns))
    head = separator.join(["timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw", *names])
    return "\n".join((head, *(separator.join(map(repr, row)) for row in poses.tolist()))) + "\n"


def as_csv(estimate: Trajectory) -> str:
    upper = [(i, j) for i in range(6) for j in range(i, 6)]
    columns = np.column_stack([estimate.covariances[:, i, j] for i, j in upper])
    return table(estimate, [f"cov_{AXES[i]}_{AXES[j]}" for i, j in upper], columns, ",")


def as_numbers(estimate: Trajectory) -> str:
    names = [f"field.pose.covariance{k}" for k in range(36)] + [
        f"field.twist.covariance{k}" for k in range(2)
    ]
    columns = np.column_stack((estimate.covariances.reshape(-1, 36), np.ones((len(estimate), 2))))
    return table(estimate, names, columns, ",")


def as_openvins(estimate: Trajectory) -> str:
    upper = [(i, j) for i in range(3) for j in range(i, 3)]
    body = np.swapaxes(estimate.matrices, 1, 2)
    turned = body @ estimate.covariances[:, 3:, 3:] @ estimate.matrices
    columns = [turned[:, i, j] for i, j in upper] + [estimate.covariances[:, i, j] for i, j in upper]
    names = [f"P{kind}{i + 1}{j + 1}" for kind in "rt" for i, j in upper]
    return "# " + table(estimate, names, np.column_stack(columns), " ").replace("timestamp", "timestamp(s)")


@pytest.mark.parametrize("write", [as_csv, as_numbers, as_openvins])
def test_columns(tmp_path: Path, estimate: Trajectory, write: Callable[[Trajectory], str]) -> None:
    (tmp_path / "est").write_text(write(estimate))
    found = read_trajectory(tmp_path / "est")
    expected = estimate.covariances.copy()
    if write is as_openvins:
        expected[:, :3, 3:] = expected[:, 3:, :3] = 0.0
    np.testing.assert_allclose(found.covariances, expected, rtol=1e-9, atol=1e-15)


def test_positions_only(tmp_path: Path) -> None:
    (tmp_path / "est").write_text(
        "time,x,y,z,cov_xx,cov_xy,cov_yy,cov_zz\n1,0,0,0,4,1,5,6\n2,0,0,0,4,1,5,6\n"
    )
    found = read_trajectory(tmp_path / "est").covariances
    assert found is not None
    np.testing.assert_array_equal(found[1], [[4, 1, 0], [1, 5, 0], [0, 0, 6]])


@pytest.mark.parametrize(
    "names", ["cov_xx,cov_xy,cov_yy", "cov_xx,cov_yy,cov_zz,cov_zz", "cov_xx,cov_yy,cov_zyaw"]
)
def test_incomplete_columns_are_passed_over(tmp_path: Path, names: str) -> None:
    row = ",1" * len(names.split(","))
    (tmp_path / "est").write_text(f"time,x,y,z,{names}\n1,0,0,0{row}\n")
    assert read_trajectory(tmp_path / "est").covariances is None


def write_bag(path: Path, estimate: Trajectory) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    with Writer(path) as writer:
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        connection = writer.add_connection("/pose", kind, typestore=store)
        for k in range(len(estimate)):
            seconds = int(estimate.stamps[k])
            nanoseconds = round((estimate.stamps[k] - seconds) * 1e9)
            stamp = types["builtin_interfaces/msg/Time"](seconds, nanoseconds)
            pose = types["geometry_msgs/msg/Pose"](
                types["geometry_msgs/msg/Point"](*estimate.positions[k]),
                types["geometry_msgs/msg/Quaternion"](*estimate.quaternions[k]),
            )
            both = types["geometry_msgs/msg/PoseWithCovariance"](pose, estimate.covariances[k].ravel())
            message = types[kind](types["std_msgs/msg/Header"](k, stamp, "map"), both)
            raw = store.serialize_ros1(message, kind)
            writer.write(connection, seconds * 10**9 + nanoseconds, raw)


def run(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["consistency", *words, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_a_consistent_estimate(
    tmp_path: Path, truth: Trajectory, estimate: Trajectory, capsys: pytest.CaptureFixture[str]
) -> None:
    write_bag(tmp_path / "est.bag", estimate)
    (tmp_path / "est.csv").write_text(as_csv(estimate))
    from_bag = run(capsys, str(tmp_path / "gt.txt"), str(tmp_path / "est.bag"))
    from_table = run(capsys, str(tmp_path / "gt.txt"), str(tmp_path / "est.csv"))
    for name in ("position", "rotation", "pose"):
        assert from_bag[name]["nees"]["mean"] == pytest.approx(from_table[name]["nees"]["mean"], rel=1e-4)
        assert from_table[name]["anees"] == pytest.approx(1.0, abs=0.08)
        assert from_table[name]["neesWithin95"] == pytest.approx(0.95, abs=0.02)
        for one in from_table[name]["withinSigma"]:
            assert one["shares"] == pytest.approx([one["expected"]] * len(one["shares"]), abs=0.03)


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_one_too_sure_of_itself(
    tmp_path: Path, truth: Trajectory, estimate: Trajectory, capsys: pytest.CaptureFixture[str], factor: float
) -> None:
    boasting = Trajectory(
        estimate.stamps, estimate.positions, estimate.quaternions, covariances=factor * estimate.covariances
    )
    (tmp_path / "est.csv").write_text(as_csv(boasting))
    found = run(capsys, str(tmp_path / "gt.txt"), str(tmp_path / "est.csv"))
    assert found["pose"]["anees"] * factor == pytest.approx(1.0, abs=0.08)
    assert main(["consistency", str(tmp_path / "gt.txt"), str(tmp_path / "est.csv")]) == 0
    printed = capsys.readouterr().out
    assert all(f"{name:>9}  {3000:>6}" in printed for name in ("position", "rotation", "pose"))


def test_no_covariances(tmp_path: Path, truth: Trajectory, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["consistency", str(tmp_path / "gt.txt"), str(tmp_path / "gt.txt")]) == 2
    assert "gt.txt: has no covariances" in capsys.readouterr().err
