# SPDX-License-Identifier: Apache-2.0
"""Container executor: a workstation's runner, the program in a container of podman."""

from __future__ import annotations

from typing import Any, ClassVar

from executors.cluster import in_image
from executors.process import Process

from slamhive.local.programs.containers import Containers
from slamhive.local.programs.engines import ContainerChoice

IMAGE = "slamhive/kiss-icp:1.3.0"
"""One that has python3 and doesn't change with our own code."""


class InContainers(Process):
    """Runs sweeps as `slamhive run --container podman` does."""

    name = "container"
    container: ClassVar[ContainerChoice | None] = ContainerChoice.PODMAN

    def program(self, text: str) -> dict[str, Any]:
        return in_image(IMAGE, text)

    def label(self) -> str:
        """Return the label of its containers."""
        return Containers(self.home).identity()
