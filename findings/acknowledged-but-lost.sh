#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A reliable message that was acknowledged can be lost, and no event of ROS 2 tells.
#
# A reliable publisher that keeps all sends 200 messages while a reliable subscriber with the usual depth of
# 10 is busy. All are acknowledged (wait_for_all_acked is True), 10 arrive at the callback, the others are
# overwritten in the subscriber's history. The event message_lost isn't raised. With a depth of 200 all
# arrive.
# Expected of a history that is full: message_lost at the subscriber, or no acknowledgement.
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

cat > "$folder/history.py" << 'EOF'
import subprocess
import sys
import time

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

SENT, RELIABLE = 200, ReliabilityPolicy.RELIABLE
role, depth = sys.argv[1], int(sys.argv[2])
rclpy.init()
node = rclpy.create_node(role)
if role == "subscriber":
    got, lost = [], []
    node.create_subscription(
        Imu, "/imu", got.append, QoSProfile(depth=depth, reliability=RELIABLE),
        event_callbacks=SubscriptionEventCallbacks(message_lost=lambda event: lost.append(event.total_count)),
    )
    for _ in range(20):
        rclpy.spin_once(node, timeout_sec=0.1)
    print("ready", flush=True)
    sys.stdin.readline()  # as long as its last callback takes
    deadline = time.monotonic() + 3
    while time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(len(got), sum(lost))
else:
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=RELIABLE)
    publisher = node.create_publisher(Imu, "/imu", qos)
    command = [sys.executable, __file__, "subscriber", str(depth)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as subscriber:
        subscriber.stdout.readline()
        while not publisher.get_subscription_count():
            time.sleep(0.05)
        time.sleep(1)
        for _ in range(SENT):
            publisher.publish(Imu())
        acknowledged = publisher.wait_for_all_acked(Duration(seconds=10))
        print(acknowledged, subscriber.communicate("\n")[0].strip())
EOF

read -r acknowledged got lost < <("$folder/venv/bin/python" "$folder/history.py" publisher 10)
echo "depth 10: of 200 messages $got arrived; all acknowledged: $acknowledged; message_lost: $lost"
read -r _ all _ < <("$folder/venv/bin/python" "$folder/history.py" publisher 200)
echo "depth 200: of 200 messages $all arrived"

if [ "$acknowledged $got $lost $all" = "True 10 0 200" ]; then
    echo "as described"
else
    echo "this has changed"
    exit 1
fi
