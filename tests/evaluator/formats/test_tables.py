# SPDX-License-Identifier: Apache-2.0
"""Tables whose columns have names."""

from __future__ import annotations

import bz2
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import FileError, read_trajectory, rotation

if TYPE_CHECKING:
    from pathlib import Path

ROS1 = "%time,field.header.seq,field.header.stamp,field.header.frame_id," + ",".join(
    f"field.pose.{part}.{axis}"
    for part, axes in (("position", "xyz"), ("orientation", "xyzw"))
    for axis in axes
)
ROS2 = "header.stamp.sec,header.stamp.nanosec,position.x,position.y,position.z,yaw"
EUROC = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_x"
)


@pytest.mark.parametrize(
    "text",
    [
        "timestamp,x,y,z,qx,qy,qz,qw\n5,1,2,3,0,0,0,1\n6,4,5,6,0,0,1,0\n",
        "t tx ty tz q_x q_y q_z q_w\n5 1 2 3 0 0 0 1\n6  4 5 6 0 0 1 0\n",
        "qw;qx;qy;qz;pos_z;pos_y;pos_x;time\n1;0;0;0;3;2;1;5\n\n# done\n0;0;0;1;6;5;4;6\n",
        '"t [ms]","name",px,py,pz,ox,oy,oz,"ow"\n5000,"a, b",1,2,3,0,0,0,1\n6000,c,4,5,6,0,0,1,0\n',
        "# time_ns frame x y z yaw_deg\n5e9 a 1 2 3 0\n6e9 b 4 5 6 180\n",
        "# t yaw x y z\n5 0 1 2 3\n6 3.141592653589793 4 5 6\n",
        ROS2 + "\n5,0,1,2,3,0\n6,0,4,5,6,3.141592653589793\n",
        ROS1 + "\n9000000000,0,5e9,map,1,2,3,0,0,0,1\n9000000001,0,6e9,map,4,5,6,0,0,1,0\n",
        EUROC + "\n5000000000,1,2,3,1,0,0,0,9\n6000000000,4,5,6,0,0,0,1,9\n",
        "t,x [mm],y (cm),z_km,yaw [°],roll [deg]\n5,1000,200,0.003,0,0\n6,4000,500,0.006,180,0\n",
        "# of a drive\n# timestamp x y z qw qx qy qz\n5 1 2 3 1 0 0 0\n6 4 5 6 0 0 0 1\n",
        "# of a drive\ntimestamp,x,y,z,qw,qx,qy,qz\n5,1,2,3,1,0,0,0\n6,4,5,6,0,0,0,1\n",
        "// PositionX PosY TransZ RotationX RotY qz qw time\n1 2 3 0 0 0 1 5\n4 5 6 0 0 1 0 6\n",
        "5;1;2;3;0;0;0;1\n6;4;5;6;0;0;1;0\n",
        "# t [ms],x [mm],y [m],z,qx,qy,qz,qw\n5000,1000,2,3,0,0,0,1\n6000,4000,5,6,0,0,1,0\n",
        "# time x y z qw qx qy qz\n5,1,2,3,1,0,0,0\n6,4,5,6,0,0,0,1\n",
        "# time [s], x, y, z, qw, qx, qy, qz\n5 1 2 3 1 0 0 0\n6 4 5 6 0 0 0 1\n",
        "# ts x y z qx qy qz qw\n5 1 2 3 0 0 0 1\n6 4 5 6 0 0 1 0\n",
        "# timestamp(s) tx ty tz qx qy qz qw Pr11 Pr12\n5 1 2 3 0 0 0 1 9 9\n6 4 5 6 0 0 1 0 9 9\n",
    ],
)
def test_columns_are_known_by_name(tmp_path: Path, text: str) -> None:
    file = tmp_path / "table"
    # ROS 1 and EuRoC stamps are nanoseconds by their size, which small numbers don't have.
    text = text.replace("5e9", "1600000005000000000").replace("6e9", "1600000006000000000")
    text = text.replace("\n5000000000", "\n1600000005000000000").replace(
        "\n6000000000", "\n1600000006000000000"
    )
    file.write_bytes(bz2.compress(text.replace("\n", "\r\n").encode()))
    found = read_trajectory(file)
    np.testing.assert_array_equal(found.stamps % 1.6e9, (5, 6))
    np.testing.assert_array_equal(found.positions, ((1, 2, 3), (4, 5, 6)))
    turn = rotation.to_matrix(found.quaternions)
    np.testing.assert_allclose(turn, (np.eye(3), np.diag((-1, -1, 1))), atol=1e-15)
    assert found.oriented


def test_bare_positions_of_the_plane(tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text("x,y,speed,t\n1,2,fast,5\n3,4,slow,6\n")
    found = read_trajectory(tmp_path / "table.csv")
    assert not found.oriented
    assert not found.select(slice(1)).oriented
    np.testing.assert_array_equal(found.positions, ((1, 2, 0), (3, 4, 0)))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t,x,y,pos_x\n1,2,3,4\n", "line 1: the columns 'x' and 'pos_x' could both be x; leave one"),
        ("t,x,y\n", "nothing below the names"),
        ("t,x,y\n1,2,3\n\n2,3\n", "line 4: found 2 of 3 columns"),
        ("t,x,y\n1,2,3\n2,3,four\n", "line 3: 'four' in the column of y is no number"),
        ("t,x,y\n1,2,3\n2,inf,4\n", "line 3: tx is inf"),
        ("t,x,y\n1,2,nan\n2,nan,4\n", "all 2 rows hold NaN"),
        ("t,x,y\n2,2,3\n1,3,4\n", "line 3: time stamp 1.0"),
        ("# t;x;y;z\n5,5;2,5;3,5;0,1\n", "line 2: its numbers have a decimal comma"),
        ("t,x,y,qx,qw\n2,2,3,0,1\n", "has the columns qx, qw of qx, qy, qz, qw only"),
        ("t,x,y,yaw\n2,2,3,90\n", "the angles of yaw have no unit; name the column yaw_deg or yaw_rad"),
        ("a,b,c\n1,2,3\n", "line 1: found 'a,b,c', which is no known format"),
        ("# from here\nt,x [ft],y\n1,2,3\n", "line 2: the unit 'ft' of x isn't known; known: m, "),
        ("t [min],x,y\n1,2,3\n", "line 1: the unit 'min' of time isn't known; known: ns, "),
        ("t,x,y,yaw [gon]\n1,2,3,4\n", "line 1: the unit 'gon' of yaw isn't known; known: rad, "),
        ("t,x,y,q[0],q[1]\n1,2,3,4,5\n", "line 1: the columns 'q[0]', 'q[1]' don't say which part"),
        ("1 2 3 4 0 0 0 1\n2 2 ٣ 4 0 0 0 1\n", "line 2: '٣' is no number"),
        (",x,y,z,qx,qy,qz,qw\n1,2,3,4,0,0,0,1\n", "line 1: no column is named time"),
        (
            "t,x,y\n1,2,3\n2," + "x" * 200_000 + ",4\n",
            "line 3: 'xxxxxxxxxxxxxxxxxxxxxxxxxxxxxx…' in the column",
        ),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "table").write_text(text)
    with pytest.raises(FileError) as caught:
        read_trajectory(tmp_path / "table")
    assert says in str(caught.value)


def test_a_table_that_names_nothing(tmp_path: Path) -> None:
    (tmp_path / "table").write_text("1 2 3 4 0 0 0 1\n")
    with pytest.raises(FileError, match="names no time and position"):
        read_trajectory(tmp_path / "table", "csv")


@pytest.mark.parametrize(
    "remark", ["time x y z of t x y z as in x", "columns are time x y z and quaternion", "x, y, z, time"]
)
def test_remarks_are_no_names(tmp_path: Path, remark: str) -> None:
    (tmp_path / "tum").write_text(f"# {remark}\n1 2 3 4 0 0 0 1\n")
    np.testing.assert_array_equal(read_trajectory(tmp_path / "tum").positions, [[2, 3, 4]])


MATRIX = "1 0 0 4 0 1 0 5 0 0 1 6"


@pytest.mark.parametrize("stamp", ["1600000000000000000", "1600000000.5"])
@pytest.mark.parametrize("rest", ["", " 0 0 0 1"])
@pytest.mark.parametrize("separator", [" ", ",", "; "])
def test_a_matrix_with_a_stamp_is_not_taken_for_a_quaternion(
    tmp_path: Path, stamp: str, rest: str, separator: str
) -> None:
    (tmp_path / "poses").write_text(f"{stamp} {MATRIX}{rest}\n".replace(" ", separator))
    with pytest.raises(FileError, match=r"line 1: found a time stamp and a 3×4 pose matrix"):
        read_trajectory(tmp_path / "poses")


@pytest.mark.parametrize("text", [MATRIX, MATRIX.replace(" ", ","), "0;" + MATRIX.replace(" ", ";")])
def test_poses_of_kitti_however_they_are_separated(tmp_path: Path, text: str) -> None:
    (tmp_path / "poses").write_text(text + "\n")
    found = read_trajectory(tmp_path / "poses")
    np.testing.assert_array_equal(found.positions, [[4, 5, 6]])
    assert found.stamped_by == ("frame" if ";" in text else "line")


def test_stamps_in_nanoseconds_before_the_columns_of_tum(tmp_path: Path) -> None:
    (tmp_path / "poses").write_text("1403636579763555584.000000 1 2 3 0 0 0.6 0.8\n")  # as ORB-SLAM3 writes
    found = read_trajectory(tmp_path / "poses")
    assert found.stamps[0] == 1403636579763555584 / 1e9
    np.testing.assert_allclose(found.quaternions, [[0, 0, 0.6, 0.8]])
    assert found.notes == ("its time stamps were taken for nanoseconds",)


@pytest.mark.parametrize("stamp", ["5", "1403636579763555584"])
@pytest.mark.parametrize("separator", [" ", ","])
@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 0, 1, 2)])
def test_names_tell_the_order_of_a_quaternion(
    tmp_path: Path, stamp: str, separator: str, order: tuple[int, ...]
) -> None:
    names = ["# time", "x", "y", "z", *(("qx", "qy", "qz", "qw")[k] for k in order)]
    words = [stamp, "1", "2", "3", *(("0.6", "0", "0", "0.8")[k] for k in order)]
    (tmp_path / "poses").write_text("\n".join(map(separator.join, (names, words))) + "\n")
    np.testing.assert_allclose(read_trajectory(tmp_path / "poses").quaternions, [[0.6, 0, 0, 0.8]])


def test_text_of_two_bytes_a_letter(tmp_path: Path) -> None:
    (tmp_path / "poses").write_text("1 2 3 4 0 0 0 1\n", encoding="utf-16")
    np.testing.assert_array_equal(read_trajectory(tmp_path / "poses").positions, [[2, 3, 4]])
