# SPDX-License-Identifier: Apache-2.0
"""Stand-in of VINS-Fusion's vins_node: its only argument is the settings file."""

import sys
from pathlib import Path

import numpy as np
import rospy
from nav_msgs.msg import Odometry
from standin import CAMERAS, SENSORS, Storage, Truth, agree, between, per_sample, upright
from vins_support import Frames, append_row, check_camera, check_numbers, odometry, scaled

NOISE = {
    "acc_n": "accelerometerNoise",
    "gyr_n": "gyroscopeNoise",
    "acc_w": "accelerometerRandomWalk",
    "gyr_w": "gyroscopeRandomWalk",
}
WINDOW = 10

file = Storage(sys.argv[1])
has_imu = "imu" in SENSORS
body = "imu" if has_imu else "body"
agree("imu", file.integer("imu"), int(has_imu))
agree("num_of_cam", file.integer("num_of_cam"), len(CAMERAS))
topics = []
for number, role in enumerate(CAMERAS):
    topics.append(file.text(f"image{number}_topic"))
    agree(f"image{number}_topic", topics[-1], SENSORS[role]["topic"])
    agree(f"body_T_cam{number}", file.matrix(f"body_T_cam{number}"), between(body, role))
    calibration = file.beside(f"cam{number}_calib")
    check_camera(calibration, role)
    calibration.all_read()
agree("image_width", file.integer("image_width"), scaled(CAMERAS[0])["width"])
agree("image_height", file.integer("image_height"), scaled(CAMERAS[0])["height"])
reals = ("F_threshold", "max_solver_time", "keyframe_parallax", "td")
if has_imu:
    agree("imu_topic", file.text("imu_topic"), SENSORS["imu"]["topic"])
    agree("g_norm", file.real("g_norm"), SENSORS["imu"]["imu"]["gravity"])
    offsets = [SENSORS[role].get("timeOffset", 0.0) for role in (CAMERAS[0], "imu")]
    agree("td", file.real("td"), offsets[0] - offsets[1])
    for key, name in NOISE.items():
        agree(key, file.real(key), per_sample(name))
check_numbers(
    file,
    reals,
    (
        *("max_cnt", "min_dist", "show_track", "flow_back", "max_num_iterations", "multiple_thread"),
        *("estimate_extrinsic", "estimate_td"),
    ),
)
output = Path(file.text("output_path"))
file.all_read("load_previous_pose_graph", "pose_graph_save_path", "save_image")

truth = Truth(body)
count = 0
start = None
previous = None


def take(stamp: rospy.Time) -> None:
    global count, start  # noqa: PLW0603
    count += 1
    if file.integer("multiple_thread") and count % 2 == 0:
        return
    pose = truth.at(stamp.to_sec() + SENSORS[CAMERAS[0]].get("timeOffset", 0.0))
    if start is None:
        start = upright(pose) if has_imu else pose
    if count <= WINDOW:
        return
    message = odometry(stamp, np.linalg.inv(start) @ pose)
    publisher.publish(message)
    append_row(output / "vio.csv", message)
    if count % 3 == 0:
        keyframes.publish(message)


rospy.init_node("vins_estimator")
publisher = rospy.Publisher("~odometry", Odometry, queue_size=1000)
keyframes = rospy.Publisher("~keyframe_pose", Odometry, queue_size=1000)
frames = Frames(topics, SENSORS["imu"]["topic"] if has_imu else None, take)
rospy.spin()
