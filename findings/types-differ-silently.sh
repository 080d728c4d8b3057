#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A publisher and a subscriber of one topic with different types: nobody is told.
#
# One process publishes Imu on a topic that another subscribes to as Image. None of their events is called
# (incompatible_type, incompatible_qos, matched), nothing is logged. count_subscribers says 1,
# get_subscription_count says 0. With one type on both sides, matched is called.
# Expected: incompatible_type, which is there for this, or a line in a log.
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

cat > "$folder/types.py" << 'EOF'
import subprocess
import sys
import time

import rclpy
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from sensor_msgs.msg import Image, Imu

role, kind = sys.argv[1:]
rclpy.init()
node = rclpy.create_node(role)
called, got = [], []


def noting(name):
    return lambda _: called.append(name)


events = {name: noting(name) for name in ("incompatible_type", "incompatible_qos", "matched")}
if role == "subscriber":
    of = {"Imu": Imu, "Image": Image}[kind]
    callbacks = SubscriptionEventCallbacks(**events)
    node.create_subscription(of, "/data", got.append, 10, event_callbacks=callbacks)
else:
    publisher = node.create_publisher(Imu, "/data", 10, event_callbacks=PublisherEventCallbacks(**events))
    command = [sys.executable, __file__, "subscriber", kind]
    other = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
deadline = time.monotonic() + 6
while time.monotonic() < deadline:
    rclpy.spin_once(node, timeout_sec=0.1)
    if role == "publisher":
        publisher.publish(Imu())
        seen = node.count_subscribers("/data"), publisher.get_subscription_count()
if role == "subscriber":
    print(f"events {sorted(set(called))}, {'some' if got else 'no'} messages")
else:
    counts = f"count_subscribers {seen[0]}, get_subscription_count {seen[1]}"
    print(f"publisher: events {sorted(set(called))}, {counts}")
    print(f"subscriber: {other.communicate()[0].strip()}")
EOF

same=$("$folder/venv/bin/python" "$folder/types.py" publisher Imu 2>&1)
differ=$("$folder/venv/bin/python" "$folder/types.py" publisher Image 2>&1)
printf 'Imu to Imu\n%s\nImu to Image\n%s\n' "$same" "$differ"

if [ "$same" = "publisher: events ['matched'], count_subscribers 1, get_subscription_count 1
subscriber: events ['matched'], some messages" ] &&
    [ "$differ" = "publisher: events [], count_subscribers 1, get_subscription_count 0
subscriber: events [], no messages" ]; then
    echo "as described"
else
    echo "this has changed"
    exit 1
fi
