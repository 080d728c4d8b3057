# SPDX-License-Identifier: Apache-2.0
"""The image that others start from: the one their Dockerfile names, or a Debian made here.

Where no image registry is reached, debootstrap makes a stand-in for `debian:bookworm-slim`, as packages of
Debian are reached on many a machine that images are not. The Dockerfiles add Python to it.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from building.errors import BuildError
from building.tools import run

if TYPE_CHECKING:
    from building.recipes import Recipe
    from building.tools import Tool

STAND_IN = "localhost/debian:bookworm"
_SUITE = "bookworm"
# What debian:bookworm-slim leaves out too; copyright files stay.
_EXCLUDED = """\
path-exclude /usr/share/doc/*
path-include /usr/share/doc/*/copyright
path-exclude /usr/share/man/*
path-exclude /usr/share/info/*
path-exclude /usr/share/locale/*
"""


class Bases:
    """Finds or makes the base of each image.

    Args:
        tool: Builds the images.
        wanted: Name of the base for all of them; None takes each Dockerfile's own where it can be had.
    """

    def __init__(self, tool: Tool, wanted: str | None) -> None:
        self._tool = tool
        self._wanted = wanted
        self._reached: dict[str, bool] = {}

    def of(self, recipe: Recipe) -> tuple[str, str]:
        """Return name and identity of an image's base.

        Raises:
            BuildError: there is none, and it can't be made here.
        """
        name = self._wanted or _exact(recipe.default_base)
        if not self._reachable(name):
            if self._wanted and self._wanted != STAND_IN:
                raise BuildError(f"the base {self._wanted} is not there and no registry has it")
            name = STAND_IN
            self.make()
        image = self._tool.find(name)
        if image is None:
            raise BuildError(f"the base {name} is not there")
        return name, image.identity

    def make(self) -> None:
        """Make the stand-in, unless it is there.

        Raises:
            BuildError: it can't be made here.
        """
        if self._tool.find(STAND_IN):
            return
        if self._tool.name != "buildah":
            raise BuildError(
                "no registry of images is reached; with buildah, a base could be made by debootstrap"
            )
        if not shutil.which("debootstrap") or os.geteuid() != 0:
            raise BuildError(f"making {STAND_IN} takes root and debootstrap: apt-get install debootstrap")
        with tempfile.TemporaryDirectory() as folder:
            _bootstrap(Path(folder))

    def _reachable(self, name: str) -> bool:
        if name not in self._reached:
            self._reached[name] = self._tool.find(name) is not None or (
                name != STAND_IN and self._tool.pull(name)
            )
        return self._reached[name]


def _exact(name: str) -> str:
    """Return a name without its tag where it has a digest: buildah takes no name with both."""
    tagged, _, digest = name.partition("@")
    return f"{tagged.partition(':')[0]}@{digest}" if digest else name


def _bootstrap(folder: Path) -> None:
    root = folder / "root"
    run(["debootstrap", "--variant=minbase", "--include=ca-certificates", _SUITE, str(root)])
    (root / "etc/dpkg/dpkg.cfg.d/slim").write_text(_EXCLUDED)
    for pattern in (
        "var/cache/*",
        "var/lib/apt/lists/*",
        "var/log/*",
        "dev/*",
        "usr/share/man/*",
        "usr/share/info/*",
    ):
        _remove(root, pattern)
    _remove(root, "usr/share/locale/*")
    for path in root.glob("usr/share/doc/*/*"):
        if path.name != "copyright":
            _remove(root, str(path.relative_to(root)))
    run(["tar", "-C", str(root), "-cf", str(folder / "root.tar"), "."])
    shutil.rmtree(root)
    (folder / "Dockerfile").write_text('FROM scratch\nADD root.tar /\nCMD ["/bin/bash"]\n')
    run(["buildah", "bud", "-q", "--isolation", "chroot", "-t", STAND_IN, str(folder)])


def _remove(root: Path, pattern: str) -> None:
    for path in root.glob(pattern):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
