# SPDX-License-Identifier: Apache-2.0
"""Support that the three stand-ins of VINS-Mono share: one settings file, of which each reads its part."""

from __future__ import annotations

import rospy
from standin import SENSORS, Storage, agree, between, per_sample
from vins_support import check_camera, check_numbers

NOISE = {
    "acc_n": "accelerometerNoise",
    "gyr_n": "gyroscopeNoise",
    "acc_w": "accelerometerRandomWalk",
    "gyr_w": "gyroscopeRandomWalk",
}
_INTEGERS = (
    *("max_cnt", "min_dist", "freq", "show_track", "equalize", "fisheye", "max_num_iterations"),
    *("estimate_extrinsic", "estimate_td", "rolling_shutter", "loop_closure", "fast_relocalization"),
    *("load_previous_pose_graph", "save_image", "visualize_imu_forward"),
)
_REALS = (
    *("F_threshold", "max_solver_time", "keyframe_parallax", "td", "rolling_shutter_tr"),
    "visualize_camera_size",
)


def settings(name: str, *private: str) -> Storage:
    """Begin as the node of a name, and return the file that its parameter names, after checking all of it."""
    rospy.init_node(name)
    for parameter in ("config_file", *private):
        if not rospy.has_param(f"~{parameter}"):
            raise SystemExit(f"{name} has no private parameter {parameter}")
    file = Storage(rospy.get_param("~config_file"))
    check_camera(file, "camera")
    agree("image_topic", file.text("image_topic"), SENSORS["camera"]["topic"])
    agree("imu_topic", file.text("imu_topic"), SENSORS["imu"]["topic"])
    T_imu_camera = between("imu", "camera")
    agree("extrinsicRotation", file.matrix("extrinsicRotation"), T_imu_camera[:3, :3])
    agree("extrinsicTranslation", file.matrix("extrinsicTranslation"), T_imu_camera[:3, 3:])
    agree("g_norm", file.real("g_norm"), SENSORS["imu"]["imu"]["gravity"])
    offsets = [SENSORS[role].get("timeOffset", 0.0) for role in ("camera", "imu")]
    agree("td", file.real("td"), offsets[0] - offsets[1])
    for key, field in NOISE.items():
        agree(key, file.real(key), per_sample(field))
    check_numbers(file, _REALS, _INTEGERS)
    for key in ("output_path", "pose_graph_save_path"):
        file.text(key)
    file.all_read("mirror_parameters", "distortion_parameters", "projection_parameters")
    return file
