# SPDX-License-Identifier: Apache-2.0
"""Container images of this machine: their names, what is in them, and pulling one."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive import __version__
from slamhive.local.programs.unavailable import ImageMissing, Unavailable
from slamhive.model.rosnodes import Ros2
from slamhive.monitor.programs.engine import EngineError
from slamhive.playback.pod import PLAYER_IMAGES
from slamhive.playback.ros2 import WHEELS_RMW

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.local.programs.engines import Engine
    from slamhive.model.rosnodes import RosNode

_OF_THIS_MACHINE = "localhost/"
_OURS = ("docker.io/slamhive/", "index.docker.io/slamhive/")
_UNKNOWN_IMAGE = re.compile(r"no such image|image not known|not known|not found", re.IGNORECASE)


@dataclass(frozen=True)
class Image:
    """An image that the engine has.

    Attributes:
        identity: digest of its configuration, which names its content: ``sha256:…``.
        program: the words of its own program.
        closes_scratch: others than its owner can't write into its /tmp, as far as that shows from outside.
    """

    identity: str
    program: tuple[str, ...]
    closes_scratch: bool = False


def player_image(node: RosNode) -> str:
    """Return the name of the image that plays recordings to a node, ours unless a variable names another.

    Raises:
        Unavailable: ours hasn't the rmw that the node is to have.
    """
    own = PLAYER_IMAGES[node.ros]
    named = os.environ.get(own.variable)
    if named:
        return named
    if isinstance(node, Ros2) and node.rmw not in {None, WHEELS_RMW}:
        raise Unavailable(
            f"needs an image of a player with {node.rmw}, which ${own.variable} names: slamhive/{own.name} "
            f"has {WHEELS_RMW} alone"
        )
    return f"slamhive/{own.name}:{__version__}"


def find_image(engine: Engine, name: str) -> Image | None:
    """Return an engine's image of a name, None where it has to be pulled first.

    Raises:
        Unavailable: it isn't there, and no registry is asked for it: at a public one, the name of an image of
            ours may be anybody's.
        ImageMissing: the engine doesn't say.
    """
    found, whole = inspect(engine, name), qualified(name)
    if found is None and whole.startswith(_OF_THIS_MACHINE):
        raise Unavailable(
            f"needs the image {name}, which is in no registry and not here: {engine.name} build or "
            f"{engine.name} tag makes it"
        )
    if found is None and whole.startswith(_OURS):
        tool = "buildah" if engine.is_podman else "docker"
        raise Unavailable(
            f"needs the image {name}, which is not here and is asked of no registry: in a checkout of SLAM "
            f"Hive, images/build --tool {tool} {name} makes it"
        )
    return found


def pull(engine: Engine, name: str) -> None:
    """Pull an image, with the engine's own progress on a terminal and quietly without one.

    Raises:
        EngineError: it can't be had.
    """
    if not sys.stderr.isatty():
        engine.follow("pull", "--", name, tell=lambda _line: None)
        return
    # Both draw their progress on a terminal alone: podman on standard error, docker on standard output.
    quiet = subprocess.DEVNULL if engine.is_podman else sys.stderr
    done = subprocess.run(
        [*engine.command, "pull", "--", name], stdin=subprocess.DEVNULL, stdout=quiet, check=False
    )
    if done.returncode != 0:
        raise EngineError(f"{engine.name} pull {name} failed; what it said stands above")


def qualified(name: str) -> str:
    """Return an image's name with the registry that a cluster would take.

    >>> qualified("slamhive/kiss-icp:1.3.0"), qualified("debian:12")
    ('docker.io/slamhive/kiss-icp:1.3.0', 'docker.io/library/debian:12')
    >>> qualified("localhost/a"), qualified("lab:5000/a")
    ('localhost/a', 'lab:5000/a')
    """
    first, slash, _ = name.partition("/")
    # A first part without a dot, a colon or the name localhost is a folder of Docker Hub, not a registry.
    if slash and ("." in first or ":" in first or first == "localhost"):
        return name
    return f"docker.io/{name}" if slash else f"docker.io/library/{name}"


def inspect(engine: Engine, name: str) -> Image | None:
    """Return an engine's image of a name, None where it has none.

    Raises:
        ImageMissing: it doesn't say.
    """
    try:
        (told,) = json.loads(engine.call("image", "inspect", "--", name))
        configuration = told.get("Config") or {}
        words = [*(configuration.get("Entrypoint") or ()), *(configuration.get("Cmd") or ())]
        identity = str(told["Id"]).removeprefix("sha256:")
        closed = _closes_scratch((told.get("GraphDriver") or {}).get("Data") or {})
    except EngineError as error:
        # Engines have no exit code of their own for this, and their words differ by version.
        if _UNKNOWN_IMAGE.search(str(error)):
            return None
        raise ImageMissing(f"image {name!r}: {error}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ImageMissing(f"image {name!r}: {engine.name} doesn't say what it is") from None
    return Image(f"sha256:{identity}", tuple(map(str, words)), closed)


def _closes_scratch(layers: Mapping[str, Any]) -> bool:
    """Tell whether the uppermost of an image's layers that has a /tmp closes it to others."""
    for layer in (layers.get("UpperDir"), *str(layers.get("LowerDir")).split(":")):
        with suppress(OSError):
            return os.lstat(f"{layer}/tmp").st_mode & 0o777 != 0o777  # noqa: S108 - the image's
    return False
