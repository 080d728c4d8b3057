# SPDX-License-Identifier: Apache-2.0
"""Support that the stand-ins of LIO-SAM share: parameters below lio_sam, by type as roscpp takes them.

Their queues are longer than the real ones', so that no scan is lost on a busy machine.
"""

from __future__ import annotations

from typing import Any

import rospy
from standin import EXPECTED, SENSORS, agree, between, refuse

_TEXTS = (
    *("pointCloudTopic", "imuTopic", "odomTopic", "gpsTopic", "lidarFrame", "baselinkFrame"),
    *("odometryFrame", "mapFrame", "savePCDDirectory", "sensor"),
)
_FLAGS = ("useImuHeadingInitialization", "useGpsElevation", "savePCD", "loopClosureEnableFlag")
_INTEGERS = (
    *("N_SCAN", "Horizon_SCAN", "downsampleRate", "edgeFeatureMinValidNum", "surfFeatureMinValidNum"),
    *("numberOfCores", "surroundingKeyframeSize", "historyKeyframeSearchNum"),
)
_REALS = (
    *("gpsCovThreshold", "poseCovThreshold", "lidarMinRange", "lidarMaxRange", "imuAccNoise", "imuGyrNoise"),
    *("imuAccBiasN", "imuGyrBiasN", "imuGravity", "imuRPYWeight", "edgeThreshold", "surfThreshold"),
    *("odometrySurfLeafSize", "mappingCornerLeafSize", "mappingSurfLeafSize", "z_tollerance"),
    *("rotation_tollerance", "mappingProcessInterval", "surroundingkeyframeAddingDistThreshold"),
    *("surroundingkeyframeAddingAngleThreshold", "surroundingKeyframeDensity"),
    *("surroundingKeyframeSearchRadius", "loopClosureFrequency", "historyKeyframeSearchRadius"),
    *("historyKeyframeSearchTimeDiff", "historyKeyframeFitnessScore", "globalMapVisualizationSearchRadius"),
    *("globalMapVisualizationPoseDensity", "globalMapVisualizationLeafSize"),
)
_LISTS = {"extrinsicTrans": 3, "extrinsicRot": 9, "extrinsicRPY": 9}
_NOISE = {
    "imuAccNoise": "accelerometerNoise",
    "imuGyrNoise": "gyroscopeNoise",
    "imuAccBiasN": "accelerometerRandomWalk",
    "imuGyrBiasN": "gyroscopeRandomWalk",
    "imuGravity": "gravity",
}


def parameters(name: str) -> dict[str, Any]:
    """Begin as the node of a name, and return what stands below lio_sam, after checking all of it.

    roscpp leaves a default in place where a value is of another type, but takes whole numbers for real ones.
    """
    rospy.init_node(name)
    found: dict[str, Any] = rospy.get_param("/lio_sam", {})
    kinds: dict[str, tuple[type, ...]] = dict.fromkeys(_TEXTS, (str,)) | dict.fromkeys(_FLAGS, (bool,))
    kinds |= dict.fromkeys(_INTEGERS, (int,)) | dict.fromkeys(_REALS, (float, int))
    kinds |= dict.fromkeys(_LISTS, (list,))
    if set(found) != set(kinds):
        refuse(f"lio_sam has too much or too little: {', '.join(sorted(set(found) ^ set(kinds)))}")
    for key, allowed in kinds.items():
        if type(found[key]) not in allowed:
            refuse(f"{key} is {found[key]!r}, no {allowed[0].__name__}")
    lidar, imu = SENSORS["lidar"], SENSORS["imu"]
    agree("pointCloudTopic", found["pointCloudTopic"], lidar["topic"])
    agree("imuTopic", found["imuTopic"], imu["topic"])
    agree("N_SCAN", found["N_SCAN"], lidar["lidar"]["rings"])
    agree("Horizon_SCAN", found["Horizon_SCAN"], lidar["lidar"]["columns"])
    T_lidar_imu = between("lidar", "imu")
    agree("extrinsicTrans", found["extrinsicTrans"], T_lidar_imu[:3, 3])
    for key in ("extrinsicRot", "extrinsicRPY"):
        agree(key, found[key], T_lidar_imu[:3, :3].ravel())
    for key, field in _NOISE.items():
        agree(key, found[key], imu["imu"][field])
    for key, value in EXPECTED["settings"].items():
        agree(key, found[key], value)
    if found["lidarFrame"] != found["baselinkFrame"]:
        refuse("a transform from lidarFrame to baselinkFrame is waited for")
    return found
