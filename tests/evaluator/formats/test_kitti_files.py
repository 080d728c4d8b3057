# SPDX-License-Identifier: Apache-2.0
"""KITTI files of 12 and 13 columns, and files of unequal length."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slamhive_eval import FileError, ape_errors, read_kitti, read_trajectory
from slamhive_eval.batch import Pair, evaluate_pairs
from slamhive_eval.command import main
from slamhive_eval.evaluation import Options
from slamhive_eval.formats.files import read_estimate
from slamhive_eval.measures.kitti import kitti_errors

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from slamhive_eval import Trajectory

POSE = "1 0 0 {x} 0 1 0 0 0 0 1 0"
COMMANDS = (
    ["ape", "GT", "EST"],
    ["rpe", "GT", "EST"],
    ["kitti", "GT", "EST", "--lengths", "5"],
    ["drift", "GT", "EST"],
    ["repeated", "GT", "EST"],
    ["segments", "GT", "EST", "--restarts", "10"],
    ["report", "GT", "EST", "-o", "page.html"],
    ["ape", "GT", "EST", "EST", "--support", "common"],
    ["traj", "EST", "--reference", "GT"],
)


def lines(poses: Trajectory, frames: Iterable[int], *, indexed: bool) -> str:
    matrices = np.dstack((poses.matrices, poses.positions[:, :, None])).reshape(-1, 12)
    rows = [" ".join(map(repr, row)) for row in matrices.tolist()]
    return "".join(f"{f'{k} ' if indexed else ''}{rows[k]}\n" for k in frames)


@pytest.fixture(name="drive")
def drive_fixture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wander: Callable[..., Trajectory]
) -> tuple[Trajectory, Trajectory]:
    """Ground truth of 60 poses in the file GT of the working folder, and an estimate of as many."""
    monkeypatch.chdir(tmp_path)
    truth, estimate = wander(60, seed=1), wander(60, seed=1).transformed(np.eye(3), np.array((0.1, 0.0, 0.0)))
    estimate = estimate.moved(np.diag((-1.0, -1.0, 1.0, 1.0)))
    (tmp_path / "GT").write_text(lines(truth, range(60), indexed=False))
    return truth, estimate


def notes(found: dict[str, Any]) -> list[str]:
    """Return the notes but for the hint at the turned frame of the estimate."""
    return [note for note in found["notes"] if "180° about z" not in note]


def run(capsys: pytest.CaptureFixture[str], words: Sequence[str]) -> tuple[int, str, str]:
    code = main([*words])
    return code, *capsys.readouterr()


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_unequal_lengths_are_refused_unless_asked_for(
    drive: tuple[Trajectory, Trajectory],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    words: list[str],
) -> None:
    (tmp_path / "EST").write_text(lines(drive[1], range(55), indexed=False))
    code, out, err = run(capsys, words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "EST: has 55 poses and the ground truth GT 60 poses" in err
    assert "with --by-index" in err
    assert "frame index before the 12 numbers" in err
    note = "EST has 55 poses and the ground truth GT 60 poses: they were paired by index as far as both go"
    code, out, err = run(capsys, [*words, "--by-index"])
    assert (code, err) == (0, "")
    assert f"{note}\n" in out
    assert note in json.dumps(notes_of(json.loads(run(capsys, [*words, "--by-index", "--json"])[1])))


def notes_of(found: Any) -> Any:
    """All lists of notes in a result."""
    if isinstance(found, dict):
        return [found.get("notes", []), *map(notes_of, found.values())]
    return [notes_of(one) for one in found] if isinstance(found, list) else []


@pytest.mark.parametrize("by_index", [False, True])
def test_batch(drive: tuple[Trajectory, Trajectory], tmp_path: Path, by_index: bool) -> None:
    (tmp_path / "EST").write_text(lines(drive[1], range(55), indexed=False))
    (found,) = evaluate_pairs([Pair("GT", "EST")], [Options(alignment="none")], by_index=by_index)
    if not by_index:
        assert "EST: has 55 poses and the ground truth GT 60 poses" in found["error"]
        return
    assert found["poses"] == 55
    assert "paired by index as far as both go" in found["notes"][0]
    (tmp_path / "list").write_text("GT EST\n")
    assert main(["batch", "list", "--by-index"]) == 0


@pytest.mark.parametrize("longer", ["GT", "EST"])
def test_by_index_measures_the_common_beginning(
    drive: tuple[Trajectory, Trajectory], capsys: pytest.CaptureFixture[str], tmp_path: Path, longer: str
) -> None:
    lengths = {"GT": 55, "EST": 55, longer: 60}
    for name, poses in zip(("GT", "EST"), drive, strict=True):
        (tmp_path / name).write_text(lines(poses, range(lengths[name]), indexed=False))
    found = json.loads(run(capsys, ["ape", "GT", "EST", "--by-index", "--json"])[1])
    truth, estimate = (poses.select(slice(55)) for poses in drive)
    assert found["poses"] == 55
    assert found["rmse"] == pytest.approx(np.sqrt(np.mean(ape_errors(truth, estimate) ** 2)), rel=1e-12)


def test_as_many_lines_pair_without_a_note(
    drive: tuple[Trajectory, Trajectory], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "EST").write_text(lines(drive[1], range(60), indexed=False))
    for more in ([], ["--by-index"]):
        found = json.loads(run(capsys, ["ape", "GT", "EST", *more, "--json"])[1])
        assert (found["poses"], notes(found)) == (60, [])


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kept=st.sets(st.integers(0, 59), min_size=1), kept_truth=st.sets(st.integers(0, 59)))
def test_the_frame_index_pairs_what_both_have(
    drive: tuple[Trajectory, Trajectory], tmp_path: Path, kept: set[int], kept_truth: set[int]
) -> None:
    kept_truth |= {max(kept)}
    (tmp_path / "EST").write_text(lines(drive[1], sorted(kept), indexed=True))
    (tmp_path / "GT13").write_text(lines(drive[0], sorted(kept_truth), indexed=True))
    for name, theirs in (("GT", set(range(60))), ("GT13", kept_truth)):
        truth = read_trajectory(name)
        estimate = read_estimate("EST", truth, name)
        both = sorted(kept & theirs)
        options = Options(alignment="none", rpe=())
        (found,) = evaluate_pairs([Pair(name, "EST")], [options])
        assert (found["poses"], found["notes"]) == (len(both), [])
        assert estimate.stamps.tolist() == sorted(kept)
        if len(both) >= 3:
            a, b = (poses.select(np.array(both)) for poses in drive)
            assert found["ate"]["rmse"] == pytest.approx(np.sqrt(np.mean(ape_errors(a, b) ** 2)), rel=1e-9)


def test_thirteen_columns_of_a_real_drive_are_the_same(trajectories: Path, tmp_path: Path) -> None:
    names = [trajectories / f"KITTI_00_{name}.txt" for name in ("gt", "ORB")]
    files = []
    for name in names:
        files.append(tmp_path / name.name)
        rows = name.read_text().splitlines()
        # numpy writes every number alike, those of the frames too
        files[-1].write_text("".join(f"{k:.6e} {row}\n" for k, row in enumerate(rows)))
    expected, found = (kitti_errors(*map(read_kitti, pair)).as_dict() for pair in (names, files))
    assert found == expected
    stamps = np.loadtxt(trajectories / "KITTI_00_gt_times.txt")
    np.testing.assert_array_equal(read_kitti(files[1], trajectories / "KITTI_00_gt_times.txt").stamps, stamps)


def test_speeds_of_a_ground_truth_that_lacks_frames(tmp_path: Path) -> None:
    kept = [k for k in range(121) if k % 3 != 1]
    (tmp_path / "GT").write_text("".join(f"{k} {POSE.format(x=k)}\n" for k in kept))
    truth = read_trajectory(tmp_path / "GT")
    found = kitti_errors(truth, truth, lengths=(29.5,)).segments
    assert set(found.speeds.round(9)) <= {round(29.5 / 3.1, 9), round(29.5 / 3.2, 9)}


def test_stamps_of_frames(drive: tuple[Trajectory, Trajectory], tmp_path: Path) -> None:
    (tmp_path / "times").write_text("".join(f"{0.5 * k}\n" for k in range(60)))
    (tmp_path / "EST").write_text(lines(drive[1], (0, 3, 4), indexed=True))
    assert read_kitti("EST", "times").stamps.tolist() == [0.0, 1.5, 2.0]
    (tmp_path / "times").write_text("0\n1\n2\n3\n")
    with pytest.raises(FileError, match="EST, line 3: frame 4 has no stamp; times has 4, from frame 0 on"):
        read_kitti("EST", "times")
    found = read_trajectory("EST", times="times", by_index=True)
    assert found.stamps.tolist() == [0.0, 3.0]
    assert found.notes == ("EST has 3 poses and times 4 stamps: they were paired by index as far as both go",)


@pytest.mark.parametrize("count", [55, 65])
def test_times_of_another_number(
    drive: tuple[Trajectory, Trajectory], capsys: pytest.CaptureFixture[str], tmp_path: Path, count: int
) -> None:
    (tmp_path / "times").write_text("".join(f"{0.5 * k}\n" for k in range(60)))
    rows = lines(drive[1], range(60), indexed=False).splitlines() * 2
    (tmp_path / "EST").write_text("\n".join(rows[:count]))
    words = ["ape", "GT", "EST", "--times", "times"]
    code, _, err = run(capsys, words)
    assert code == 2
    assert f"times: has 60 stamps for the {count} poses of EST" in err
    found = json.loads(run(capsys, [*words, "--by-index", "--json"])[1])
    assert found["poses"] == min(count, 60)
    assert len(notes(found)) == 1


@pytest.mark.parametrize(
    ("frames", "says"),
    [
        ("0 1.5 2", "EST, line 2: the frame index is 1.5; it must be a whole number from 0"),
        ("0 nan 2", "EST, line 2: the frame index is nan; it must be a whole number from 0"),
        ("-1 0 1", "EST, line 1: the frame index is -1; it must be a whole number from 0"),
        ("0 1 1e300", "EST, line 3: the frame index is 1e+300; it must be a whole number"),
        ("0 1 1", "EST, line 3: frame 1 is there twice"),
        ("0 5 2", "EST, line 3: frame 2 comes after frame 5; frames must ascend"),
        ("0 x 2", "EST, line 2: 'x' is no number; expected the frame index and the 3×4 pose matrix"),
        ("0 58 60 61", "EST, line 3: there is no frame 60 in the ground truth GT, which ends with frame 59"),
    ],
)
def test_wrong_frames_name_file_and_line(
    drive: tuple[Trajectory, Trajectory],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    frames: str,
    says: str,
) -> None:
    (tmp_path / "EST").write_text("".join(f"{k} {POSE.format(x=n)}\n" for n, k in enumerate(frames.split())))
    code, out, err = run(capsys, ["ape", "GT", "EST"])
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert says in err


def test_a_line_without_its_frame(tmp_path: Path) -> None:
    (tmp_path / "EST").write_text(f"0 {POSE.format(x=1)}\n{POSE.format(x=2)}\n")
    with pytest.raises(
        FileError, match="line 2: found 12 of 13 values; expected the frame index and the 3×4"
    ):
        read_trajectory(tmp_path / "EST")


def test_sorting_by_frames(
    drive: tuple[Trajectory, Trajectory],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    (tmp_path / "EST").write_text("# poses\n" + "".join(f"{k} {POSE.format(x=k)}\n" for k in (0, 5, 2)))
    found = read_trajectory("EST", unsorted="sort")
    assert found.stamps.tolist() == found.positions[:, 0].tolist() == [0, 2, 5]
    (tmp_path / "EST").write_text("# poses\n" + "".join(f"{k} {POSE.format(x=k)}\n" for k in (5, 70, 5, 2)))
    with pytest.raises(FileError, match="line 4: frame 5 is there twice"):
        read_trajectory("EST", unsorted="sort")
    (tmp_path / "EST").write_text("# poses\n" + "".join(f"{k} {POSE.format(x=k)}\n" for k in (80, 70, 5)))
    code, _, err = run(capsys, ["ape", "GT", "EST", "--sort"])
    assert code == 2
    assert "EST, line 3: there is no frame 70" in err


def test_beyond_the_ground_truth_by_index(
    drive: tuple[Trajectory, Trajectory], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "GT").write_text(lines(drive[0], range(0, 50, 2), indexed=True))
    (tmp_path / "EST").write_text(lines(drive[1], range(10, 60), indexed=True))
    found = json.loads(run(capsys, ["ape", "GT", "EST", "--by-index", "--json"])[1])
    assert found["poses"] == 20
    (note,) = notes(found)
    assert note.startswith(
        "EST has 50 poses up to frame 59 and the ground truth GT 25 poses up to frame 48: "
    )


@pytest.mark.parametrize("stamped", ["GT", "EST"])
def test_by_index_is_for_poses_without_times(
    drive: tuple[Trajectory, Trajectory], capsys: pytest.CaptureFixture[str], tmp_path: Path, stamped: str
) -> None:
    (tmp_path / "EST").write_text(lines(drive[1], range(55), indexed=False))
    (tmp_path / stamped).write_text("".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(55)))
    code, _, err = run(capsys, ["ape", "GT", "EST", "--by-index"])
    assert code == 2
    assert f"--by-index is for KITTI poses without times, and {stamped} has time stamps" in err


def test_named_columns_stay_what_they_are(tmp_path: Path) -> None:
    names = "timestamp tx ty tz qx qy qz qw a b c d e"
    (tmp_path / "EST").write_text(f"# {names}\n7.5 1 2 3 0 0 0 1 1 2 3 4 5\n")
    assert read_trajectory(tmp_path / "EST").stamps.tolist() == [7.5]
