# SPDX-License-Identifier: Apache-2.0
"""Folders to start an algorithm from: examples that run as they are, under a name of the user's."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.local.home.catalog import bundled, editor_line, link_algorithm
from slamhive.model.base import Choice, require_name
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home

_BUILD_SECONDS = 60
EDITOR_LINE = re.compile(r"^# yaml-language-server: .*\n", re.MULTILINE)
"""The line of a manifest that leads an editor to its schema."""


class ExampleKind(Choice):
    """Kinds of examples that the folder of a new algorithm can be started from."""

    LIDAR_PYTHON = "lidar-python"
    ROS1_NODE = "ros1-node"
    ROS2_NODE = "ros2-node"
    PROGRAM = "program"


_SHARED = {
    ExampleKind.LIDAR_PYTHON: [("algorithms", "adapter_support.py"), ("algorithms", "adapter_recording.py")],
    ExampleKind.ROS1_NODE: [("examples", "algorithms/lidar-python/odometry.py")],
    ExampleKind.ROS2_NODE: [("examples", "algorithms/lidar-python/odometry.py")],
    ExampleKind.PROGRAM: [],
}
"""Files that a folder gets besides its example's own."""


def start_algorithm(
    name: str, kind: ExampleKind, home: Home, workshop: Workshop, parent: Path
) -> tuple[Path, str]:
    """Make a folder for an algorithm and make it known by its name.

    Args:
        name: the algorithm's name, and the folder's.
        kind: what it is begun as.
        home: where it is made known.
        workshop: the catalog, which must not have the name yet.
        parent: where the folder is made.

    Returns:
        The folder, and what is left to do before it runs, empty where nothing is.

    Raises:
        InputError: the name can't be used, or the folder can't be made.
    """
    _check_name(name, workshop)
    folder = parent / name
    if folder.exists() or folder.is_symlink():
        raise InputError(f"{folder} is there already; nothing is overwritten: choose another name")
    try:
        aside = Path(tempfile.mkdtemp(prefix=f".{name}.", dir=parent))
    except OSError as error:
        raise InputError(f"{parent}: {error.strerror}") from None
    try:
        _fill(aside, name, kind)
        left = _build(aside, name) if kind is ExampleKind.PROGRAM else ""
        aside.chmod(0o755)
        aside.rename(folder)
    except BaseException:
        shutil.rmtree(aside, ignore_errors=True)
        raise
    try:
        # Not before the folder has its name: the home would link to what is moved away.
        link_algorithm(folder, home, built=not left)
    except InputError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder, left


def _check_name(name: str, workshop: Workshop) -> None:
    require_name(name, "NAME")
    if name in workshop.algorithm_entries:
        where = workshop.algorithm(name).folder
        raise InputError(f"NAME: the algorithm {name!r} is known already ({where}); choose another name")


def _fill(folder: Path, name: str, kind: ExampleKind) -> None:
    source = bundled("examples") / "algorithms" / kind.value
    files = [path for path in sorted(source.iterdir()) if path.is_file() and path.name != "odometry"]
    files += [bundled(place) / path for place, path in _SHARED[kind]]
    for path in files:
        target = folder / path.name
        text = path.read_text(encoding="utf-8").replace(f"my-{kind.value}", name)
        # The example's own line leads to a schema beside the examples.
        text = EDITOR_LINE.sub(lambda _: editor_line("Algorithm"), text)
        target.write_text(text, encoding="utf-8")
        target.chmod(0o755 if text.startswith("#!") else 0o644)


def _build(folder: Path, name: str) -> str:
    """Build the program, where there is a compiler; say what is left to do otherwise."""
    how = f"make -C {name}"
    # No reason to refuse: whoever begins a program of their own may have another way to build it.
    if shutil.which("make") is None or shutil.which("cc") is None:
        return f"{how}   (apt-get install gcc libc6-dev make)"
    try:
        done = subprocess.run(
            ["make", "-s"], cwd=folder, capture_output=True, check=False, timeout=_BUILD_SECONDS
        )
    except (OSError, subprocess.TimeoutExpired):
        return how
    return how if done.returncode else ""
