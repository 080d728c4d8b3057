# SPDX-License-Identifier: Apache-2.0
"""Loading of images into a cluster that pulls from no registry: the test cluster's node, or kind's."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from building.errors import BuildError
from building.tools import run

if TYPE_CHECKING:
    from building.tools import Tool


def test_cluster() -> Path:
    """Return the socket of containerd on the node that ``make cluster-up`` starts, whether it runs or not."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slamhive-cluster"
    return Path(os.environ.get("SLAMHIVE_CLUSTER_HOME") or cache) / "run-default" / "containerd.sock"


def load(tool: Tool, reference: str) -> str:
    """Put an image into the cluster of this machine, unless it is there.

    Args:
        tool: What built the image.
        reference: Its name.

    Returns:
        What was done, in a few words.

    Raises:
        BuildError: there is no cluster on this machine.
    """
    socket = test_cluster()
    command = ["ctr", "-a", str(socket), "-n", "k8s.io", "images"]
    if socket.exists() and shutil.which("ctr"):
        image = tool.find(reference)
        if image and _same(run([*command, "ls"]), reference, image.identity):
            return "is in the test cluster"
        return _hand_over(tool, reference, [*command, "import"], "loaded into the test cluster")
    for name in _kind_clusters():
        into = ["kind", "load", "image-archive", "--name", name]
        return _hand_over(tool, reference, into, f"loaded into the kind cluster {name}")
    raise BuildError("no cluster to load images into: start one by make cluster-up or kind create cluster")


def _same(listing: str, reference: str, identity: str) -> bool:
    """Tell from containerd's list whether a name stands for the image of that identity."""
    digests = {words[0]: words[2] for words in map(str.split, listing.splitlines()) if len(words) > 2}
    return reference in digests and digests[reference] == digests.get(identity)


def _kind_clusters() -> list[str]:
    if not shutil.which("kind"):
        return []
    result = subprocess.run(["kind", "get", "clusters"], capture_output=True, text=True, check=False)
    return result.stdout.split() if result.returncode == 0 else []


def _hand_over(tool: Tool, reference: str, command: list[str], done: str) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "image.tar"
        tool.archive(reference, path)
        run([*command, str(path)])
    return done
