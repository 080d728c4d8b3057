# SPDX-License-Identifier: Apache-2.0
"""Start without a container: has roslaunch find this folder as a package, and run what was rendered."""

import os
import shutil
import sys
from pathlib import Path

if __name__ == "__main__":
    here = str(Path(__file__).resolve().parent)
    before = os.environ.get("ROS_PACKAGE_PATH")
    os.environ["ROS_PACKAGE_PATH"] = f"{here}:{before}" if before else here
    roslaunch = shutil.which("roslaunch")
    if roslaunch is None:
        sys.exit("roslaunch is not there: apt-get install python3-roslaunch")
    os.execv(roslaunch, [roslaunch, f"{os.environ['SLAMHIVE_FILES']}/run.launch"])  # noqa: S606
