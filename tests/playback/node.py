# SPDX-License-Identifier: Apache-2.0
"""A ROS 1 node that acts as its parameter says: each scan gives it a pose that lies 1 m per second ahead."""

import os
import re
import signal
import sys
import time
from pathlib import Path

import rospy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import PointCloud2
from tf2_msgs.msg import TFMessage

run = Path(os.environ["SLAMHIVE_RUN"])
act = re.search(r"^  act: (\S+)$", (run / "config.yaml").read_text(), re.MULTILINE)[1]
kinds = {
    "PoseStamped": PoseStamped,
    "PoseWithCovarianceStamped": PoseWithCovarianceStamped,
    "Odometry": Odometry,
    "Path": PathMessage,
    "TF": TFMessage,
}
path = PathMessage()
keyframes = PathMessage()
scans = 0


def message_of(scan: PointCloud2) -> object:
    message = TransformStamped() if act == "TF" else kinds.get(act, Odometry)()
    message.header.stamp = scan.header.stamp
    ahead = scan.header.stamp.to_sec() - 1_600_000_000
    if act == "TF":
        message.header.frame_id, message.child_frame_id = "odom", "base"
        place, turn = message.transform.translation, message.transform.rotation
        place.x, turn.w = ahead, 1.0
        world = TransformStamped()
        world.header.stamp, world.header.frame_id, world.child_frame_id = scan.header.stamp, "map", "odom"
        world.transform.translation.y, world.transform.rotation.w = 7.0, 1.0
        return TFMessage([world, message])
    if act == "Path":
        message = PoseStamped(header=scan.header)
    pose = message.pose if act in {"PoseStamped", "Path"} else message.pose.pose
    pose.position.x, pose.orientation.w = ahead, 1.0
    if act == "Path":
        path.poses.append(message)
        for item in path.poses:  # as after a loop closure: all of them move
            item.pose.position.z = float(len(path.poses))
        return path
    return message


def take(scan: PointCloud2) -> None:
    global scans  # noqa: PLW0603
    scans += 1
    if act == "crash" and scans == 5:
        sys.stderr.write("lost the map\n")
        sys.stderr.flush()
        os._exit(3)
    if act == "quits" and scans == 15:
        os._exit(0)
    if act == "slow":
        time.sleep(0.06)
    if act != "silent":
        publisher.publish(message_of(scan))
    if act == "Odometry" and scans % 10 == 1:
        keyframes.poses.append(PoseStamped(header=scan.header))
        keyframes.poses[-1].pose.orientation.w = 1.0
        for item in keyframes.poses:
            item.pose.position.x = float(len(keyframes.poses))
        optimised.publish(keyframes)


if act == "broken":
    sys.exit("can't open the vocabulary")
rospy.init_node("actor", disable_signals=act == "stubborn")
publisher = rospy.Publisher(
    "/tf" if act == "TF" else "/actor/poses", kinds.get(act, Odometry), queue_size=100
)
optimised = rospy.Publisher("/actor/keyframes", PathMessage, queue_size=100)
if act == "stubborn":
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
if act != "deaf":
    topic = "/elsewhere/points" if act == "Odometry" else "/points"
    rospy.Subscriber(topic, PointCloud2, take, queue_size=1 if act == "slow" else 100, buff_size=1 << 24)
while not rospy.is_shutdown():
    time.sleep(0.02)
if act == "final":
    (run / "output" / "trajectory.txt").write_text("1600000000.0 9 9 9 0 0 0 1\n1600000001.0 9 9 9 0 0 0 1\n")
if act == "careless":
    raise rospy.ROSInterruptException("nobody caught it")
if act == "fault":
    os.kill(os.getpid(), signal.SIGSEGV)
