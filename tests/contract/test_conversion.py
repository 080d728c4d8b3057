# SPDX-License-Identifier: Apache-2.0
"""Poses that a program wrote in its own way, made into the contract's file, with real trajectories."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.contract import conversion
from slamhive.contract.lines import TextFault
from slamhive.contract.output import KEYFRAMES, read_output
from slamhive.contract.posefiles import COLUMNS, DeclaredPoseFile

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
SAME_NAMES = {name: name for name in COLUMNS}
LINE = "{} 1 2 3 0 0 0 1\n"
IDENTITY = "1 0 0 4 0 1 0 5 0 0 1 6\n"


def rotations() -> Any:
    """Return SciPy's rotations; importing them takes a second, which all workers would spend to collect."""
    return pytest.importorskip("scipy.spatial.transform", reason="scipy is an extra").Rotation


def real(part: str) -> Path:
    """Return a file of the shared data."""
    path = SHARED / part
    if not path.exists():
        pytest.skip(f"../shared/data/{part} is not here")
    return path


@pytest.fixture
def output(tmp_path: Path) -> Path:
    folder = tmp_path / "output"
    folder.mkdir()
    return folder


def frames_of(folder: Path, stamps: list[int]) -> str:
    """Write stamps of frames as a preparation does, ns."""
    path = folder / "frames.txt"
    path.write_text("".join(f"{stamp}\n" for stamp in stamps))
    return str(path)


def converted(output: Path, source: DeclaredPoseFile, frames: str | None = None) -> Array:
    """Return the converted poses: stamps, positions, quaternions, shape (n, 8)."""
    conversion.convert(str(output), source, frames, "trajectory.txt")
    return np.loadtxt(output / "trajectory.txt", ndmin=2)


def matrices(poses: Array) -> Array:
    """Return poses as matrices, shape (n, 4, 4)."""
    found = np.tile(np.eye(4), (len(poses), 1, 1))
    found[:, :3, :3] = rotations().from_quat(poses[:, 4:]).as_matrix()
    found[:, :3, 3] = poses[:, 1:4]
    return found


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("name", ["KITTI_00_gt.txt", "KITTI_00_ORB.txt"])
def test_kitti_rows_as_scipy_reads_them(output: Path, tmp_path: Path, name: str, *, inverted: bool) -> None:
    text = real(f"trajectories/{name}").read_text()
    times = real("trajectories/KITTI_00_gt_times.txt").read_text().split()
    stamps = [round(float(time) * 1e9) for time in times]
    (output / "poses.txt").write_text(text)
    source = DeclaredPoseFile("poses.txt", "Kitti", "frame-index", inverted=inverted)
    found = converted(output, source, frames_of(tmp_path, stamps))
    rows = np.array([line.split() for line in text.splitlines()], dtype=float).reshape(-1, 3, 4)
    wanted = np.tile(np.eye(4), (len(rows), 1, 1))
    wanted[:, :3] = rows
    if inverted:
        wanted = np.linalg.inv(wanted)
    np.testing.assert_array_equal(found[:, 0], np.array(stamps) / 1e9)
    # The file's own matrices are orthonormal to their seven digits, which shows in positions of 500 m.
    np.testing.assert_allclose(matrices(found)[:, :3, :3], wanted[:, :3, :3], atol=2e-6)
    np.testing.assert_allclose(found[:, 1:4], wanted[:, :3, 3], atol=2e-3 if inverted else 0)
    np.testing.assert_allclose(np.linalg.norm(found[:, 4:], axis=1), 1, atol=1e-12)


def test_kitti_rows_that_name_their_frames(output: Path, tmp_path: Path) -> None:
    (output / "poses.txt").write_text(f"1 {IDENTITY}3.000000 {IDENTITY}")
    source = DeclaredPoseFile("poses.txt", "Kitti", "frame-index")
    found = converted(output, source, frames_of(tmp_path, [10**9, 2 * 10**9, 3 * 10**9, 4 * 10**9 + 1]))
    assert found[:, 0].tolist() == [2.0, 4.000000001]


def test_seconds_of_a_kitti_folder_count_from_its_first_frame(output: Path, tmp_path: Path) -> None:
    times = real("trajectories/KITTI_00_gt_times.txt").read_text().split()[:300]
    first = 1_600_000_000_123_456_789
    frames = frames_of(tmp_path, [first + round(float(time) * 1e9) for time in times])
    (output / "poses.txt").write_text("".join(LINE.format(time) for time in times))
    converted(output, DeclaredPoseFile("poses.txt", "Tum", "s-since-first"), frames)
    stamps = [line.split()[0] for line in (output / "trajectory.txt").read_text().splitlines()]
    assert [int(stamp.replace(".", "")) for stamp in stamps] == [*map(int, Path(frames).read_text().split())]


def test_euroc_ground_truth_of_a_real_flight(output: Path) -> None:
    """Compare it, with the header, velocities and biases that the dataset has, with a copy in TUM's order."""
    reference = np.loadtxt(real("icra2023/groundtruth/MH_01_easy.txt"))
    lines = [
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    ]
    for stamp, x, y, z, qx, qy, qz, qw in reference:
        lines.append(f"{round(stamp * 1e5)}0000,{x},{y},{z},{qw},{qx},{qy},{qz},0,0,0,-0.002,0.02,0.07,0,0,0")
    (output / "data.csv").write_text("\r\n".join(lines) + "\r\n")
    found = converted(output, DeclaredPoseFile("data.csv", "Euroc", "ns"))
    np.testing.assert_allclose(found, reference, rtol=0, atol=1e-12)


def test_inverted_poses_of_a_real_run(output: Path) -> None:
    reference = np.loadtxt(real("icra2023/runs/050/traj.txt"))
    inverse = np.linalg.inv(matrices(reference))
    turns = rotations().from_matrix(inverse[:, :3, :3]).as_quat()
    turns *= 1.03  # as some programs leave them
    np.savetxt(output / "Tcw.txt", np.column_stack([reference[:, 0], inverse[:, :3, 3], turns]), fmt="%.9f")
    found = converted(output, DeclaredPoseFile("Tcw.txt", "Tum", "s", inverted=True))
    np.testing.assert_allclose(matrices(found), matrices(reference), atol=1e-7)


@pytest.mark.parametrize("seed", range(8))
def test_matrices_of_all_turns(output: Path, tmp_path: Path, seed: int) -> None:
    """Half turns too, where most ways to a quaternion divide by zero."""
    draw = np.random.default_rng(seed)
    axes = np.concatenate([np.eye(3), -np.eye(3), draw.normal(size=(40, 3))])
    angles = np.concatenate([np.full(26, np.pi), draw.uniform(-np.pi, np.pi, 20)])
    turns = rotations().from_rotvec(axes / np.linalg.norm(axes, axis=1, keepdims=True) * angles[:, None])
    wanted = np.concatenate([turns.as_matrix(), draw.normal(size=(len(axes), 3, 1))], axis=2)
    np.savetxt(output / "poses.txt", wanted.reshape(-1, 12), fmt="%.17g")
    source = DeclaredPoseFile("poses.txt", "Kitti", "frame-index")
    found = converted(output, source, frames_of(tmp_path, [*range(len(axes))]))
    np.testing.assert_allclose(matrices(found)[:, :3], wanted, atol=1e-14)


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_tables_without_a_first_line(output: Path, separator: str) -> None:
    header = ("n", "timestamp", "tx", "ty", "tz", "qw", "qx", "qy", "qz", "n")
    rows = [f"1 {7 + k} 1 2 3 0.5 0.5 -0.5 0.5 9" for k in range(2)]
    (output / "table.csv").write_text(
        "\n# a, remark; it is\n" + "\n".join(rows).replace(" ", separator) + "\n"
    )
    found = converted(output, DeclaredPoseFile("table.csv", "Csv", "s", columns=SAME_NAMES, header=header))
    assert found.tolist() == [[7, 1, 2, 3, 0.5, -0.5, 0.5, 0.5], [8, 1, 2, 3, 0.5, -0.5, 0.5, 0.5]]


def test_a_first_line_that_was_said_not_to_be_there(output: Path) -> None:
    (output / "table.csv").write_text(",".join(COLUMNS) + "\n1,1,2,3,0,0,0,1\n")
    with pytest.raises(TextFault, match=r"line 1: 'timestamp' is no number; expected the columns that its"):
        converted(output, DeclaredPoseFile("table.csv", "Csv", "s", columns=SAME_NAMES, header=COLUMNS))


@pytest.mark.parametrize(
    ("head", "row", "columns"),
    [
        ("timestamp,tx,ty,tz,qx,qy,qz,qw", "7,1,2,3,0.5,-0.5,0.5,0.5", SAME_NAMES),
        ('"timestamp";"qw";"qx";"qy";"qz";"tx";"ty";"tz"', '7;0.5;0.5;-0.5;0.5;"1";2; 3', SAME_NAMES),
        ("# timestamp tx ty tz qx qy qz qw n", "7 1 2 3 0.5 -0.5 0.5 0.5 9", SAME_NAMES),
        ("a\tb\tty\ttz\tqx\tqy\tqz\tqw", "7\t1\t2\t3\t0.5\t-0.5\t0.5\t0.5", {"timestamp": "a", "tx": "b"}),
        ("t [s],ty,tz,qx,qy,qz,qw,p x,", "7,2,3,0.5,-0.5,0.5,0.5,1,", {"timestamp": "t [s]", "tx": "p x"}),
    ],
)
def test_tables_by_their_first_line(output: Path, head: str, row: str, columns: dict[str, str]) -> None:
    (output / "table.csv").write_text(f"\n{head}\n# a remark\n{row}\n\n")
    found = converted(output, DeclaredPoseFile("table.csv", "Csv", "s", columns=SAME_NAMES | columns))
    assert found.tolist() == [[7, 1, 2, 3, 0.5, -0.5, 0.5, 0.5]]


@pytest.mark.parametrize(
    ("word", "seconds"),
    [
        ("1403636579763555584", "1403636579.763555584"),
        ("1403636579763555584.000000", "1403636579.763555584"),  # as SaveTrajectoryEuRoC of ORB-SLAM3
        ("1.403636579763555584e18", "1403636579.763555584"),
        ("0", "0.000000000"),
        ("-1500000000", "-1.500000000"),
    ],
)
def test_nanoseconds_are_exact(output: Path, word: str, seconds: str) -> None:
    (output / "poses.txt").write_text(LINE.format(word))
    conversion.convert(str(output), DeclaredPoseFile("poses.txt", "Tum", "ns"), None, "trajectory.txt")
    assert (output / "trajectory.txt").read_text() == LINE.format(seconds)


@pytest.mark.parametrize(
    ("source", "text"),
    [
        (("Tum", "s", True), LINE.format(1) + "2 1 2 nan 0 0 0 1\n" + LINE.format(3)),
        (("Euroc", "ns"), "1000000000 1 2 3 1 0 0 0\n2e9 1 2 3 nan 0 0 0\n3000000000 1 2 3 1 0 0 0\n"),
        (("Kitti", "frame-index"), IDENTITY + IDENTITY.replace("1", "nan", 1) + IDENTITY),
    ],
)
def test_rows_of_nan_are_kept_for_an_evaluation_to_count(output: Path, source: Any, text: str) -> None:
    (output / "file").write_text(text)
    frames = output / "frames.txt"
    frames.write_text("".join(f"{10**9 * k}\n" for k in range(3)))
    found = converted(output, DeclaredPoseFile("file", *source), str(frames))
    assert np.isnan(found).any(axis=1).tolist() == [False, True, False]
    assert (np.diff(found[:, 0]) > 0).all()


WRONG: list[tuple[Any, str, str]] = [
    (
        ("Tum", "s"),
        LINE.format(1403636579763555584),
        "line 1: time stamp 1.40363658e+18 is no number of seconds",
    ),
    (("Tum", "s"), IDENTITY, "line 1: found 12 of 8 values; expected timestamp tx ty tz qx qy qz qw"),
    (
        ("Tum", "s"),
        "0,5 1,5 2,5 3,5 0,0 0,0 0,0 1,0\n",
        "line 1: found 16 of 8 values; numbers with a decimal comma? write a point",
    ),
    (("Tum", "s"), "0 1 2 3 4 5 6 7\n", "line 1: the quaternion qx qy qz qw = 4 5 6 7 has norm 11.2, not 1"),
    (("Tum", "s"), LINE.format(2) + LINE.format(1), "line 2: time stamp 1.000000000 s comes before"),
    (
        ("Tum", "s"),
        LINE.format(1) + "\n#\n2 1 2 inf 0 0 0 1\n",
        "line 4: tz is inf; every value must be finite",
    ),
    (("Tum", "s"), LINE.format("1_0"), "line 1: '1_0' is no number"),
    (
        ("Tum", "ns"),
        LINE.format("1.5"),
        "line 1: time stamp '1.5' is no whole number of nanoseconds (seconds",
    ),
    (("Tum", "ns"), LINE.format("1e-99999999999999999999"), "line 1: time stamp '1e-99999"),
    (("Tum", "ns"), LINE.format("9" * 40), "line 1: time stamp 1e+40 is no number of nanoseconds"),
    (("Tum", "ns"), LINE.format("inf"), "line 1: time stamp inf is no number of nanoseconds"),
    (("Tum", "ns"), LINE.format("x"), "line 1: 'x' is no number of nanoseconds"),
    (
        ("Tum", "frame-index"),
        LINE.format(2) + LINE.format(3),
        "line 2: frame 3 is beyond the recording, which has",
    ),
    (("Tum", "frame-index"), LINE.format(-1), "line 1: '-1' is no frame index; frames are counted from 0"),
    (("Tum", "frame-index"), LINE.format(0.5), "line 1: '0.5' is no frame index; frames are counted from 0"),
    (("Tum", "frame-index"), LINE.format("1e400"), "line 1: '1e400' is no frame index"),
    (
        ("Tum", "frame-index"),
        LINE.format(2) + LINE.format(0),
        "line 2: time stamp 0.000000000 s comes before",
    ),
    (("Tum", "s-since-first"), LINE.format(2) + LINE.format(1), "line 2: time stamp"),
    (("Tum", "s-since-first"), LINE.format("1e12"), "line 1: '1e12' is no number of seconds since the first"),
    (("Tum", "s-since-first"), LINE.format("nan"), "line 1: 'nan' is no number of seconds since the first"),
    (("Euroc", "ns"), "1,2,3\n", "line 1: found 3 of 8 values; expected timestamp, tx, ty, tz, qw"),
    (
        ("Euroc", "ns"),
        "timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z\n",
        "line 1: 'timestamp' is no number of nanoseconds",
    ),
    (("Kitti", "frame-index"), LINE.format(0), "line 1: found 8 of 12 values; expected the 3×4 pose matrix"),
    (("Kitti", "frame-index"), IDENTITY * 4, "line 4: frame 3 is beyond the recording, which has 3 frames"),
    (
        ("Kitti", "frame-index"),
        IDENTITY + "1 " + IDENTITY,
        "line 2: found 13 values, and 12 in the lines above",
    ),
    (
        ("Kitti", "frame-index"),
        IDENTITY.replace("1", "-1"),
        "line 1: its first three columns are no rotation",
    ),
    (
        ("Kitti", "frame-index"),
        IDENTITY.replace("1", "1.1"),
        "line 1: its first three columns are no rotation",
    ),
    (("Kitti", "frame-index"), IDENTITY.replace("6", "inf"), "line 1: the pose matrix holds inf"),
    (("Kitti", "frame-index"), IDENTITY.replace("6", "x"), "line 1: 'x' is no number; expected the 3×4"),
    (
        ("Kitti", "s"),
        IDENTITY,
        "line 1: found 12 values, which hold no time stamp; declare stamps: frame-index",
    ),
    (
        ("Csv", "s"),
        LINE.format(1),
        "line 1: the first line has no column 'timestamp'; it names 1, 1, 2, 3, 0",
    ),
    (("Csv", "s"), "x," * 9, "line 1: the first line has no column 'timestamp'; it names x, x"),
    (("Csv", "s"), ",".join([*COLUMNS, "tx"]), "line 1: the first line has 2 columns 'tx'"),
    (("Csv", "s"), ",".join(COLUMNS) + "\n1,2,3,4\n", "line 2: found 4 of at least 8 values"),
    (("Csv", "s"), ",".join(COLUMNS) + "\n1,2,,4,0,0,0,1\n", "line 2: '' is no number"),
    (("Tum", "s"), "1" * (1 << 18), "line 1: is longer than 64 KiB"),
    (("Tum", "s"), LINE.format(1) + "\0", "poses.txt: is no text file (it holds zero bytes)"),
    (("Tum", "s"), "\x1f\x8b\x08", "poses.txt is compressed; it must be plain text"),
    (("Csv", "s"), "a" * 60_000 + "\n", "line 1: the first line has no column 'timestamp'; it names aaaa"),
]


@pytest.mark.parametrize(("form", "text", "message"), WRONG)
def test_what_is_wrong_is_said_with_file_and_line(
    output: Path, tmp_path: Path, form: tuple[str, str], text: str, message: str
) -> None:
    (output / "poses.txt").write_bytes(text.encode("latin-1", "replace"))
    (output / "trajectory.txt").write_text("the program's own\n")
    columns = SAME_NAMES if form[0] == "Csv" else None
    with pytest.raises(TextFault) as caught:
        converted(
            output, DeclaredPoseFile("poses.txt", *form, columns=columns), frames_of(tmp_path, [0, 10, 20])
        )
    said = str(caught.value)
    assert said.startswith("output/poses.txt")
    assert message.partition("must be finite")[0] in said
    assert len(said) < 400
    assert sorted(path.name for path in output.iterdir()) == ["poses.txt", "trajectory.txt"]
    assert (output / "trajectory.txt").read_text() == "the program's own\n"


def test_what_grows_beyond_the_limit_is_refused(output: Path, tmp_path: Path) -> None:
    """A row of 24 bytes becomes one of 50."""
    (output / "poses.txt").write_text(IDENTITY * 40_000)
    source, frames = (
        DeclaredPoseFile("poses.txt", "Kitti", "frame-index"),
        frames_of(tmp_path, [*range(40_000)]),
    )
    with pytest.raises(TextFault, match="its poses take more than 1 MiB as output/trajectory"):
        conversion.convert(str(output), source, frames, "trajectory.txt", 1 << 20)
    assert [path.name for path in output.iterdir()] == ["poses.txt"]


def told(**more: Any) -> dict[str, Any]:
    source = {"path": "poses.txt", "format": "Tum", "stamps": "s"}
    return {"trajectory": source | more}


def test_both_files_are_made_and_the_programs_own_stay(output: Path) -> None:
    (output / "poses.txt").write_text(LINE.format(1) + LINE.format(2) + LINE.format(3))
    (output / "keys.txt").write_text(LINE.format(2 * 10**9))
    keyframes = {"path": "keys.txt", "format": "Tum", "stamps": "ns"}
    found = read_output(str(output), poses=told() | {"keyframes": keyframes})
    assert found.trajectory.info is not None
    assert (found.trajectory.info.poses, found.keyframes, found.fault) == (3, None, None)
    assert (output / KEYFRAMES).read_text() == LINE.format("2.000000000")
    names = {"poses.txt", "keys.txt", KEYFRAMES, "trajectory.txt"}
    assert {path.name for path in output.iterdir()} == names


def test_keyframes_alone_beside_a_trajectory_of_the_contract(output: Path) -> None:
    (output / "trajectory.txt").write_text(LINE.format(1))
    keyframes = {"path": "keys.txt", "format": "Tum", "stamps": "s"}
    found = read_output(str(output), poses={"keyframes": keyframes})
    assert found.trajectory.info is not None
    assert found.metrics_problem(None) == "output/keys.txt is missing or not a regular file"


@pytest.mark.parametrize(
    ("poses", "missing"), [(None, "output/trajectory.txt"), ("poses.txt", "output/poses.txt")]
)
def test_files_of_other_names_are_named_where_poses_are_missing(
    output: Path, poses: str | None, missing: str
) -> None:
    for name in ("CameraTrajectory.txt", "f_dataset-KF.txt", "map.bin", "z.log", "metrics.json"):
        (output / name).write_text("{}")
    found = read_output(str(output), poses=told() if poses else None).trajectory
    assert found.missing
    assert found.problem == (
        f"{missing} is missing or not a regular file; beside it: 'CameraTrajectory.txt', 'f_dataset-KF.txt', "
        "'map.bin' and 1 more (an Algorithm says in output.trajectory where its poses are)"
    )


def link_of_the_output(output: Path) -> None:
    (output / "poses.txt").write_text(LINE.format(1))
    output.rename(output.with_name("elsewhere"))
    output.symlink_to("elsewhere")


@pytest.mark.parametrize(
    "spoil",
    [
        lambda output: (output / "poses.txt").symlink_to("/etc/passwd"),
        lambda output: os.mkfifo(output / "poses.txt"),
        lambda output: (output / "poses.txt").mkdir(),
        lambda output: output.rmdir(),
        link_of_the_output,
    ],
)
def test_nothing_leads_out_of_the_output(output: Path, spoil: Callable[[Path], object]) -> None:
    spoil(output)
    found = read_output(str(output), poses=told())
    assert found.trajectory.problem == "output/poses.txt is missing or not a regular file"
    assert (found.trajectory.missing, found.fault) == (True, None)
    assert not list(output.parent.rglob("trajectory.txt"))


@pytest.mark.parametrize("call", ["open", "write", "fsync", "replace"])
def test_a_disk_that_refuses_is_no_fault_of_the_algorithm(
    output: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    (output / "poses.txt").write_text(LINE.format(1))
    given = getattr(os, call)

    def refused(*arguments: Any, **named: Any) -> Any:
        if call != "open" or arguments[1] & os.O_CREAT:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return given(*arguments, **named)

    monkeypatch.setattr(os, call, refused)
    found = read_output(str(output), poses=told())
    assert found.fault == "output/trajectory.txt can't be written: No space left on device"
    assert [path.name for path in output.iterdir()] == ["poses.txt"]


@pytest.mark.parametrize("text", [None, "1.5\n", "x\n", f"{2**70}\n"])
def test_stamps_of_frames_that_can_not_be_read_are_no_fault_of_the_algorithm(
    output: Path, tmp_path: Path, text: str | None
) -> None:
    (output / "poses.txt").write_text(LINE.format(0))
    frames = tmp_path / "frames.txt"
    if text is not None:
        frames.write_text(text)
    found = read_output(str(output), poses=told(stamps="frame-index") | {"frames": str(frames)})
    assert found.fault is not None
    assert found.fault.startswith(f"the stamps of the recording's frames can't be read: {frames}: ")
