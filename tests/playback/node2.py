# SPDX-License-Identifier: Apache-2.0
"""A ROS 2 node that acts as its parameter says: each scan gives it a pose that lies 1 m per second ahead."""

import copy
import os
import re
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.executors import ExternalShutdownException
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, PointCloud2
from transforms import TransformMessage, transforms

run = Path(os.environ["SLAMHIVE_RUN"])
told = (run / "config.yaml").read_text()
act = re.search(r"^  act: (\S+)$", told, re.MULTILINE)[1]
seed = int(re.search(r"^seed: (\d+)$", told, re.MULTILINE)[1])
kinds = {
    "PoseStamped": PoseStamped,
    "PoseWithCovarianceStamped": PoseWithCovarianceStamped,
    "Odometry": Odometry,
    "Path": PathMessage,
    "TF": TransformMessage,
}
FLOOD = 200
path = PathMessage()
keyframes = PathMessage()
scans = 0


def message_of(scan: PointCloud2) -> object:
    stamp = scan.header.stamp
    ahead = stamp.sec - 1_600_000_000 + stamp.nanosec / 1e9
    if act == "TF":
        return transforms((stamp, "map", "odom", (0.0, 7.0, 0.0)), (stamp, "odom", "base", (ahead, 0.0, 0.0)))
    message = PoseStamped() if act == "Path" else kinds.get(act, Odometry)()
    if act == "wall":
        message.header.stamp = node.get_clock().now().to_msg()
    elif act != "stampless":
        message.header.stamp = stamp
    pose = message.pose if act in {"PoseStamped", "Path"} else message.pose.pose
    pose.position.x, pose.orientation.w = ahead, 1.0
    if act == "signed":  # so that it is seen whose poses were recorded
        pose.position.y = float(seed)
    if act != "Path":
        return message
    path.poses.append(message)
    for item in path.poses:  # as after a loop closure: all of them move
        item.pose.position.z = float(len(path.poses))
    return path


def publish_more(message: Odometry) -> None:
    """Publish what comes beside the scan's own pose."""
    if act == "twice":
        message.pose.pose.position.z = 5.0
        publisher.publish(message)
    if act == "flood":
        message = copy.deepcopy(message)
        for _ in range(FLOOD - 1):  # as one that goes along with its IMU would, faster
            message.header.stamp.nanosec += 1000
            publisher.publish(message)


def take(scan: PointCloud2) -> None:
    global scans  # noqa: PLW0603
    scans += 1
    if act == "crash" and scans == 5:
        sys.stderr.write("lost the map\n")
        sys.stderr.flush()
        os._exit(3)
    if act == "quits" and scans == 15:
        os._exit(0)
    time.sleep(node.get_parameter("delay").value)
    if act != "silent":
        message = message_of(scan)
        publisher.publish(message)
        publish_more(message)
    if act == "Odometry" and scans % 10 == 1:
        keyframes.poses.append(PoseStamped(header=scan.header))
        keyframes.poses[-1].pose.orientation.w = 1.0
        for item in keyframes.poses:
            item.pose.position.x = float(len(keyframes.poses))
        optimised.publish(keyframes)


def listen() -> None:
    """Subscribe to the scans, in the way that the act asks for."""
    topic = {"Odometry": "/elsewhere/points", "PoseStamped": "~/cloud", "Path": "cloud"}.get(act, "/points")
    qos = QoSProfile(depth=100)
    if act == "slow":
        qos = qos_profile_sensor_data
    if act == "latched":
        qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
    node.create_subscription(Image if act == "picture" else PointCloud2, topic, take, qos)


if act == "broken":
    sys.exit("can't open the vocabulary")
rclpy.init(
    args=sys.argv,
    signal_handler_options=SignalHandlerOptions.NO if act == "stubborn" else SignalHandlerOptions.ALL,
)
if act == "stubborn":
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
own = [Parameter("use_sim_time", value=True)] if act == "Odometry" else []  # others are told, or forget it
node = rclpy.create_node("actor", parameter_overrides=own, allow_undeclared_parameters=act == "liberal")
node.declare_parameter("delay", 0.0)
publisher = node.create_publisher(kinds.get(act, Odometry), "/tf" if act == "TF" else "/actor/poses", 1000)
optimised = node.create_publisher(PathMessage, "/actor/keyframes", 100)
if act == "deaf":
    node.create_subscription(Image, "/camera/image", take, 10)
else:
    listen()
if act == "careless":
    rclpy.spin(node)  # without a word for what SIGINT raises
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(node)
if act == "final":
    (run / "output" / "trajectory.txt").write_text("1600000000.0 9 9 9 0 0 0 1\n1600000001.0 9 9 9 0 0 0 1\n")
if act == "fault":
    os.kill(os.getpid(), signal.SIGSEGV)
