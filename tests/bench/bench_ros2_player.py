# SPDX-License-Identifier: Apache-2.0
"""The player of ROS 2 beside a loop that decodes what it publishes, and beside ROS 1's player.

A rig's recording (clouds of 2 MB at 10 Hz, IMU at 200 Hz, two images at 20 Hz) is played at its own speed to
a node that gives each cloud a pose: by ours, and by an rclpy node that reads, decodes and publishes it. Then
by ours again while another job takes all processors.

Run: python tests/bench/bench_ros2_player.py [SECONDS [BUSY RUNS]]
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.local.home.catalog import Workshop
from slamhive.local.home.folder import Home
from slamhive.model.algorithm import Algorithm
from slamhive.playback.ros import find_ros
from slamhive.playback.ros2 import WHEELS, wheels_fault

sys.path.append(str(Path(__file__).parents[1] / "playback"))
import rig

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.model.results import RunRecord

SECONDS, BUSY_RUNS, ROUNDS = 10, 2, 2
LOOP_DOMAIN = "101"
"""One that no player takes."""
ROLES = ("lidar", "imu", "left", "right")
NODE = """
import sys, rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import Image, Imu, PointCloud2

rclpy.init(args=sys.argv)
node = rclpy.create_node("taker")
everything = QoSProfile(depth=0, history=HistoryPolicy.KEEP_ALL)
poses = node.create_publisher(Odometry, "/taker/poses", everything)
stamp = lambda data: (int.from_bytes(data[4:8], "little"), int.from_bytes(data[8:12], "little"))
def take(data):
    message = Odometry()
    message.header.stamp.sec, message.header.stamp.nanosec = stamp(data)
    message.pose.pose.orientation.w = 1.0
    poses.publish(message)
for kind, topic in (Imu, "/imu"), (Image, "/left/image_raw"), (Image, "/right/image_raw"):
    node.create_subscription(kind, topic, lambda data: None, everything, raw=True)
node.create_subscription(PointCloud2, "/points", take, everything, raw=True)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
ROS1_NODE = """
import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, Imu, PointCloud2

rospy.init_node("taker")
poses = rospy.Publisher("/taker/poses", Odometry, queue_size=1000)
def take(data):
    message = Odometry()
    raw = data._buff
    message.header.stamp = rospy.Time(int.from_bytes(raw[4:8], "little"), int.from_bytes(raw[8:12], "little"))
    message.pose.pose.orientation.w = 1.0
    poses.publish(message)
for topic in "/imu", "/left/image_raw", "/right/image_raw":
    rospy.Subscriber(topic, rospy.AnyMsg, lambda data: None, buff_size=1 << 24)
rospy.Subscriber("/points", rospy.AnyMsg, take, buff_size=1 << 24)
rospy.spin()
"""
LOOP = """
import json, resource, sys, time
from pathlib import Path
import rclpy
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, Imu, PointCloud2

rclpy.init()
node = rclpy.create_node("loop")
everything = QoSProfile(depth=0, history=HistoryPolicy.KEEP_ALL)
kinds = {f"sensor_msgs/msg/{one.__name__}": one for one in (Image, Imu, PointCloud2)}
clock = node.create_publisher(Clock, "/clock", 10)
with Reader(Path(sys.argv[1])) as reader:
    publishers = {one.topic: node.create_publisher(kinds[one.msgtype], one.topic, everything)
                  for one in reader.connections if one.msgtype in kinds}
    while min(one.get_subscription_count() for one in publishers.values()) < 1:
        time.sleep(0.05)
    time.sleep(1.0)
    before, begin, late, bytes_, ticked = time.process_time(), time.monotonic(), [], 0, 0.0
    first = reader.start_time
    for connection, stamp, raw in reader.messages():
        if connection.topic not in publishers:
            continue
        message = deserialize_message(bytes(raw), kinds[connection.msgtype])
        due = begin + (stamp - first) / 1e9
        while (now := time.monotonic()) < due:
            if now - ticked >= 0.01:
                ticked = now
                told = Clock()
                told.clock.sec, told.clock.nanosec = divmod(first + int((now - begin) * 1e9), 10**9)
                clock.publish(told)
            time.sleep(max(0.0, min(due - time.monotonic(), 0.01)))
        late.append(time.monotonic() - due)
        publishers[connection.topic].publish(message)
        bytes_ += len(raw)
late.sort()
print(json.dumps({"cpu": time.process_time() - before, "seconds": time.monotonic() - begin,
                  "messages": len(late), "bytes": bytes_, "p99": late[int(0.99 * (len(late) - 1))]}))
"""


class Played(NamedTuple):
    """A run by a player of ours.

    Attributes:
        record: Of the run.
        cpu: CPU of the player while it played, s.
        before: From the start of the player, which comes first, to the first message, s.
        after: From the last pose to the end of the run, s.
    """

    record: RunRecord
    cpu: float
    before: float
    after: float


class Desk:
    """A home with the recording and a node of either ROS.

    Args:
        path: its folder.
        seconds: length of the recording.
    """

    def __init__(self, path: Path, seconds: int) -> None:
        self._home = Home.at(path)
        self._workshop = Workshop()
        self._number = 0
        (path / "rig").mkdir()
        bag = path / "rig" / "rig.bag"
        rig.record(bag, seconds)
        self._workshop.add([rig.dataset(bag)], bag.parent)
        for version, code in ((1, ROS1_NODE), (2, NODE)):
            self._add_node(version, code, path / f"taker{version}")

    def _add_node(self, version: int, code: str, folder: Path) -> None:
        folder.mkdir()
        (folder / "adapter.py").write_text(code)
        (folder / "requirements.txt").write_text(WHEELS.read_text() if version == 2 else "")
        node: dict[str, Any] = {"poses": {"topic": "/taker/poses", "type": "Odometry"}}
        if version == 2:
            node["arguments"] = "Ros"
        spec = {
            "local": {},
            "recording": ["Mcap" if version == 2 else "Rosbag1"],
            "modes": [{"name": "stereo-inertial", "roles": list(ROLES)}],
            "output": {"frame": "lidar"},
            "paces": ["Realtime"],
            "realtime": {"queue": 1000},
            f"ros{version}": node,
        }
        named = {"metadata": {"name": f"taker{version}"}, "spec": spec}
        self._workshop.add([Algorithm.model_validate(named)], folder)

    def play(self, version: int) -> RunRecord:
        """Have the recording played once, and return the run."""
        self._number += 1
        return rig.play(self._home, self._workshop, f"taker{version}", f"run-{self._number}")

    def measured(self, version: int) -> Played:
        """Have it played once, and return what that took."""
        record = self.play(version)
        if record.phase != "Succeeded" or record.finished is None:
            raise SystemExit(f"taker{version}: {record.message}")
        folder = Path(record.folder or "")
        report = json.loads((folder / "run" / "output" / "playback.json").read_text())
        begun, ended = report["playStart"], report["playEnd"]
        started, cpu = cpu_between(folder / "player", begun, ended)
        return Played(record, cpu, begun - started, record.finished.timestamp() - ended)

    def loop(self, played: Path) -> dict[str, float]:
        """Run the loop that decodes, with a node like ours and the transport of a run that was played."""
        python = json.loads((played / "supervisor.json").read_text())["argv"][0]
        recording = (played / "run" / "dataset" / "recording.mcap").resolve()
        told: dict[str, str] = json.loads((played / "player" / "node.json").read_text())["variables"]
        variables = {**os.environ, **told, "ROS_DOMAIN_ID": LOOP_DOMAIN, "ROS_LOG_DIR": str(self._home.path)}
        words = [python, "-c", NODE, "--ros-args", "-p", "use_sim_time:=true"]
        with subprocess.Popen(words, env=variables, stderr=subprocess.DEVNULL) as node:
            command = [python, "-c", LOOP, str(recording)]
            done = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
            node.send_signal(signal.SIGINT)
        if done.returncode:
            raise SystemExit(done.stderr[-2000:])
        found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
        return found


def cpu_between(folder: Path, begin: float, end: float) -> tuple[float, float]:
    """Return the start of a supervised program, and its CPU, s, between two times of the wall clock."""
    told = json.loads((folder / "summary.json").read_text())["startedAt"]
    started = datetime.fromisoformat(told).timestamp()
    lines = (folder / "usage.csv").read_text().splitlines()[1:]
    total = before = 0.0
    for line in lines:
        at, cores = (float(text) for text in line.split(",")[:2])
        inside = min(at, end - started) - max(before, begin - started)
        total += max(inside, 0.0) * cores
        before = at
    return started, total


@contextmanager
def busy() -> Iterator[None]:
    """Take all processors meanwhile."""
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in os.sched_getaffinity(0)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()


def report(what: str, ours: str, limit: str) -> None:
    """Print one figure."""
    print(f"{what} · {ours} · {limit}", flush=True)


def lost_nothing(desk: Desk, runs: int) -> tuple[int, list[float], list[str]]:
    """Return the number of runs beside another job that lost nothing, their lateness (p99, s), complaints."""
    late, complaints = [], []
    with busy():
        for _ in range(runs):
            record = desk.play(2)
            if record.phase == "Succeeded":
                late.append(record.metrics["playerLateSeconds"]["p99"])
            else:
                complaints.append(str(record.message))
    return len(late), late, complaints


def main() -> None:
    """Measure and print."""
    seconds = int(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    runs = int(sys.argv[2]) if len(sys.argv) > 2 else BUSY_RUNS
    reason = wheels_fault()
    if reason is not None:
        report("player of ROS 2", "not measured", reason)
        return
    with tempfile.TemporaryDirectory() as temporary:
        desk = Desk(Path(temporary), seconds)
        desk.play(2)  # makes environments and the recording's variant
        ours = desk.measured(2)
        loop = desk.loop(Path(ours.record.folder or ""))
        metrics = ours.record.metrics
        took, share = metrics["playSeconds"], ours.cpu / loop["cpu"]
        about = f"{loop['messages']:.0f} messages, {loop['bytes'] / 1e6:.0f} MB"
        report(
            f"ROS 2 player, {about} at their own speed",
            f"{loop['messages'] / took:.0f} messages/s, {loop['bytes'] / took / 1e6:.1f} MB/s",
            f"loop that decodes {loop['messages'] / loop['seconds']:.0f} messages/s",
        )
        report(
            "CPU of the player while it plays",
            f"{ours.cpu / took:.3f} cores, {share:.0%} of the loop's",
            f"loop that decodes {loop['cpu'] / loop['seconds']:.3f} cores; limit 33%",
        )
        report(
            "lateness of messages, p99",
            f"{metrics['playerLateSeconds']['p99'] * 1e3:.2f} ms",
            f"loop that decodes {loop['p99'] * 1e3:.2f} ms",
        )
        rounds = {version: [desk.measured(version) for _ in range(ROUNDS)] for version in versions()}
        best = {
            version: min(((one.before, one.after) for one in found), key=sum)
            for version, found in rounds.items()
        }
        peers = best.get(1, ("no ROS 1 here",) * 2)
        for what, own, peer in zip(
            ("start to first message", "last pose to end"), best[2], peers, strict=True
        ):
            limit = f"ROS 1's {peer:.2f} s" if isinstance(peer, float) else peer
            report(f"{what}, best of {ROUNDS}", f"{own:.2f} s", limit)
        if 1 in rounds:
            cpu = min(one.cpu / one.record.metrics["playSeconds"] for one in rounds[1])
            report("CPU of ROS 1's player for the same", f"{cpu:.3f} cores", f"ROS 2's {ours.cpu / took:.3f}")
        whole, late, complaints = lost_nothing(desk, runs)
        told = f"lateness p99 {max(late) * 1e3:.0f} ms at worst" if late else ""
        report(
            f"nothing lost by the witness beside a job on all cores, runs of {seconds} s",
            f"{whole} of {runs} runs; {'; '.join([told, *sorted(set(complaints))])}",
            f"all {runs}",
        )


def versions() -> tuple[int, ...]:
    """Return the ROS that can be measured here."""
    return (1, 2) if find_ros() is not None else (2,)


if __name__ == "__main__":
    main()
