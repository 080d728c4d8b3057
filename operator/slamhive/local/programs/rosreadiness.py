# SPDX-License-Identifier: Apache-2.0
"""Readiness of this machine for ROS nodes: rows of ``slamhive doctor``, as `readiness` has the others."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.local.programs.players import player_base
from slamhive.local.programs.readiness import size_text
from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.readiness import ReadinessRow, State, limited, missing, there
from slamhive.playback.player.ros2.transport import SHARED_MEMORY
from slamhive.playback.protocol import LEAST_SHARED_MEMORY
from slamhive.playback.ros import PACKAGES, find_ros, missing_packages, what_it_takes
from slamhive.playback.ros2 import find_ros2, ros2_fault

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.local.home.catalog import Workshop

_INSTALLED = Path("/opt/ros")


def ros1(workshop: Workshop) -> ReadinessRow:
    """Look for ROS 1, and whether what takes it can run."""
    nodes = sorted(
        name for name, entry in workshop.algorithm_entries.items() if entry.algorithm.spec.ros1 is not None
    )
    release = find_ros()
    if release is not None:
        return there("ROS 1", f"rospy {release.release} for {release.python}")
    costs = f"the ROS 1 nodes {', '.join(nodes)} run in containers and on clusters alone" if nodes else ""
    state = State.MISSING if nodes else State.UNNEEDED
    lacking = missing_packages()
    some = f"not whole, without {', '.join(lacking)}" if 0 < len(lacking) < len(PACKAGES) else "not here"
    return ReadinessRow("ROS 1", state, some, costs, what_it_takes() if nodes else "")


def ros2(workshop: Workshop) -> ReadinessRow:
    """Look for what a player of ROS 2 nodes is made from."""
    entries = workshop.algorithm_entries.items()
    nodes = sorted(name for name, entry in entries if entry.algorithm.spec.ros2 is not None)
    # A ROS 2 that is not sourced is found by its folder; one that is sourced may be installed elsewhere.
    there_is = sorted({path.parent.name for path in _INSTALLED.glob("*/local_setup.sh")})
    installed = f"not sourced, though there is {', '.join(there_is)}" if there_is else "not installed"
    sourced, fault = find_ros2(), ros2_fault()
    found = f"{sourced.release} for {sourced.python}" if sourced is not None else fault or installed
    try:
        base = player_base()
    except Unavailable as error:
        if not nodes:
            return ReadinessRow("ROS 2", State.UNNEEDED, f"{found}; its bags are read without it")
        costs = f"the ROS 2 nodes {', '.join(nodes)} run in containers and on clusters alone: {error}"
        return missing("ROS 2", found, costs, "a sourced ROS 2, or what its wheels need")
    if base.python.ros is None:
        python = ".".join(map(str, base.python.version))
        found = f"{found}; nodes are played to by wheels of ROS 2 for Python {python}"
    if sourced is None and (fault is not None or there_is):
        costs = "nodes in Python whose requirements do not bring rclpy do not run here"
        helps = (
            "source the setup of a ROS 2 that is whole"
            if fault
            else f"source {_INSTALLED / there_is[-1]}/setup.bash"
        )
        return limited("ROS 2", found, costs, helps)
    return there("ROS 2", found)


def shared_memory(workshop: Workshop, folder: Path = Path(SHARED_MEMORY)) -> Iterator[ReadinessRow]:
    """Look whether there is shared memory for ROS 2 nodes, where the catalog has some that run here."""
    entries = workshop.algorithm_entries.values()
    if not any(entry.algorithm.spec.ros2 and entry.algorithm.spec.local for entry in entries):
        return
    costs = "nothing is played to ROS 2 nodes: their runs end as a fault of the machine"
    helps = f"mount -o remount,size=1G {folder}"
    if not (folder.is_dir() and os.access(folder, os.W_OK)):
        found = f"{folder} can't be written" if folder.is_dir() else f"{folder} is not there"
        yield missing("shared memory", found, costs, f"mount -t tmpfs -o size=1G,mode=1777 tmpfs {folder}")
        return
    usage = shutil.disk_usage(folder)
    found = f"{size_text(usage.free)} of {size_text(usage.total)} free at {folder}"
    if usage.free < LEAST_SHARED_MEMORY:
        least = f"{size_text(LEAST_SHARED_MEMORY)} are needed for each run at a time"
        yield limited("shared memory", f"{found}; {least}", costs, helps)
        return
    count = usage.free // LEAST_SHARED_MEMORY
    yield there("shared memory", f"{found}, for {count} ROS 2 {'node' if count == 1 else 'nodes'} at a time")
