# SPDX-License-Identifier: Apache-2.0
"""Stand-in of lio_sam_imageProjection: a queue of three scans, each of which waits for the IMU."""

import threading
from collections import deque

import numpy as np
import rospy
from lio_sam_support import parameters
from sensor_msgs.msg import Imu, PointCloud2, PointField
from std_msgs.msg import Header

KINDS = {PointField.FLOAT32: "<f4", PointField.UINT16: "<u2"}
FIELDS = {
    "x": PointField.FLOAT32,
    "y": PointField.FLOAT32,
    "z": PointField.FLOAT32,
    "intensity": PointField.FLOAT32,
    "ring": PointField.UINT16,
    "time": PointField.FLOAT32,
}

told = parameters("lio_sam_imageProjection")
lock = threading.Lock()
scans: deque[PointCloud2] = deque()
last = 0.0


def problem_of(cloud: PointCloud2) -> str | None:
    found = {field.name: (field.datatype, field.offset) for field in cloud.fields}
    wrong = [name for name, kind in FIELDS.items() if found.get(name, (0, 0))[0] != kind]
    if wrong or not cloud.is_dense:
        return f"not dense, or without the fields {wrong}"
    layout = {
        "names": list(FIELDS),
        "formats": [KINDS[kind] for kind in FIELDS.values()],
        "offsets": [found[name][1] for name in FIELDS],
        "itemsize": cloud.point_step,
    }
    points = np.frombuffer(cloud.data, np.dtype(layout))
    if (np.diff(points["time"]) < 0).any():
        return "points out of the order of time"
    return "more rings than N_SCAN" if points["ring"].max(initial=0) >= told["N_SCAN"] else None


def take(cloud: PointCloud2) -> None:
    problem = problem_of(cloud)
    if problem is not None:
        rospy.logfatal(problem)
        rospy.signal_shutdown(problem)
        return
    with lock:
        scans.append(cloud)
        go_on()


def hear(sample: Imu) -> None:
    global last  # noqa: PLW0603
    turn = sample.orientation
    if np.hypot(np.hypot(turn.x, turn.y), np.hypot(turn.z, turn.w)) < 0.1:
        rospy.signal_shutdown("please use a 9-axis IMU")
    with lock:
        last = sample.header.stamp.to_sec()
        go_on()


def go_on() -> None:
    # Two scans stay in the queue for good: they are dealt with when a third one comes.
    while len(scans) > 2 and last >= scans[0].header.stamp.to_sec() + 0.1:
        publisher.publish(scans.popleft().header)


publisher = rospy.Publisher("lio_sam/deskew/cloud_info", Header, queue_size=100)
rospy.Subscriber(told["imuTopic"], Imu, hear, queue_size=2000)
rospy.Subscriber(told["pointCloudTopic"], PointCloud2, take, queue_size=100, buff_size=1 << 24)
rospy.spin()
