#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST undoes FASTDDS_BUILTIN_TRANSPORTS, without a word.
#
# Two nodes of one machine, best effort, keeping 1000: images of 2 MB at 10 Hz. With LARGE_DATA all arrive,
# by TCP. With LARGE_DATA and the range LOCALHOST, which is what one sets for a machine alone, the publisher
# listens on no TCP port and most images, or all, are lost. Neither side logs or is told anything.
# Expected: the transports that were asked for, on the loopback interface; or an error.
#
# Takes about a minute, on x86_64 with CPython 3.10 to 3.13. Exit code: 0 as described, 1 it has changed, 2
# not runnable here.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python=${PYTHON:-python3}
"$python" -c 'import platform, sys
sys.exit(not ((3, 10) <= sys.version_info < (3, 14) and platform.machine() == "x86_64"))' || {
    echo "the wheels are for CPython 3.10 to 3.13 on x86_64; PYTHON=/path/to/python3 names another" >&2
    exit 2
}
"$python" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check 'ros-rclpy[fastrtps]==9.1.2' \
    ros-rmw-fastrtps-cpp==9.3.3 ros-fastdds==3.2.3 ros-sensor-msgs==5.5.1 || exit 2
"$folder/venv/bin/pip" list --disable-pip-version-check 2> /dev/null \
    | grep -E '^ros-(rclpy|rmw-fastrtps-cpp|fastdds|sensor-msgs) '

unset ROS_AUTOMATIC_DISCOVERY_RANGE ROS_LOCALHOST_ONLY ROS_STATIC_PEERS RMW_IMPLEMENTATION
unset FASTDDS_BUILTIN_TRANSPORTS FASTDDS_DEFAULT_PROFILES_FILE FASTRTPS_DEFAULT_PROFILES_FILE
export ROS_DOMAIN_ID=$((1 + $$ % 100)) ROS_LOG_DIR=$folder

cat > "$folder/images.py" << 'EOF'
import array
import os
import subprocess
import sys
import time

import rclpy
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

SENT, LAST = 30, 1000
QOS = QoSProfile(depth=1000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)


def listening_ports():
    """Return how many TCP ports this process listens on."""
    places = [f"/proc/self/fd/{name}" for name in os.listdir("/proc/self/fd")]
    held = {os.readlink(place) for place in places if os.path.lexists(place)}
    rows = [row.split() for name in ("tcp", "tcp6") for row in open(f"/proc/net/{name}").readlines()[1:]]
    return sum(row[3] == "0A" and f"socket:[{row[9]}]" in held for row in rows)


rclpy.init()
node = rclpy.create_node(sys.argv[1])
if sys.argv[1] == "subscriber":
    got = []
    node.create_subscription(Image, "/image", lambda image: got.append(image.header.stamp.sec), QOS)
    deadline = time.monotonic() + 20
    while LAST not in got and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(sum(0 < number < LAST for number in got))
else:
    publisher = node.create_publisher(Image, "/image", QOS)
    command = [sys.executable, __file__, "subscriber"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as subscriber:
        while not publisher.get_subscription_count():
            time.sleep(0.05)
        time.sleep(2)
        large = Image(height=1000, width=2000, step=2000, encoding="mono8")
        large.data = array.array("B", bytes(2_000_000))
        for number in range(1, SENT + 1):
            large.header.stamp.sec = number
            publisher.publish(large)
            time.sleep(0.1)
        end = Image()
        end.header.stamp.sec = LAST
        for _ in range(20):
            publisher.publish(end)
            time.sleep(0.1)
        print(f"{subscriber.communicate()[0].strip()} {listening_ports()}")
EOF

export FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA
read -r with ports < <("$folder/venv/bin/python" "$folder/images.py" publisher)
echo "LARGE_DATA: $with of 30 images arrived, $ports TCP port(s) listened on"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
read -r without none < <("$folder/venv/bin/python" "$folder/images.py" publisher)
echo "LARGE_DATA and the range LOCALHOST: $without of 30 images arrived, $none TCP port(s) listened on"

if [ "$with" -ge 27 ] && [ "$ports" -ge 1 ] && [ "$without" -lt 27 ] && [ "$none" -eq 0 ]; then
    echo "as described"
else
    echo "this has changed"
    exit 1
fi
