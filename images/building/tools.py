# SPDX-License-Identifier: Apache-2.0
"""The programs that build images: docker where its daemon answers, or buildah, which needs none."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import tarfile
import uuid
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Protocol, cast

from building.errors import BuildError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from building.recipes import Recipe

AUTHORITIES = Path("/etc/ssl/certs/ca-certificates.crt")
PIP_SETTINGS = Path("/etc/pip.conf")


@dataclass(frozen=True)
class Image:
    """An image that has been built.

    Attributes:
        identity: Hash of its configuration, `sha256:` and 64 hexadecimal digits.
        size: Bytes of its layers, unpacked.
        labels: Its labels.
    """

    identity: str
    size: int
    labels: dict[str, str]


@dataclass(frozen=True)
class Manner:
    """Choices of how images are built.

    Attributes:
        fresh: Nothing that was built before is taken.
        timestamp: Time of all files, s since 1970, which makes two builds equal; None for now.
    """

    fresh: bool = False
    timestamp: int | None = None


class Tool(Protocol):
    """A program that builds images."""

    name: str

    def find(self, reference: str) -> Image | None:
        """Return an image, None if it isn't there."""

    def pull(self, reference: str) -> bool:
        """Get an image from its registry; False if that can't be."""

    def build(self, recipe: Recipe, base: str, labels: dict[str, str]) -> None:
        """Build an image and tag it."""

    def archive(self, reference: str, path: Path) -> None:
        """Write an image to a file that `docker load` and containerd read."""

    def files(self, reference: str, wanted: Callable[[str], bool]) -> Iterator[tuple[str, bytes]]:
        """Yield the path, without a leading slash, and the content of an image's files."""


def run(command: list[str], *, log: IO[str] | None = None, cwd: Path | None = None) -> str:
    """Run a program to its end and return what it printed.

    Args:
        command: The program and its arguments.
        log: Where to write its output instead.
        cwd: Folder to run in.

    Raises:
        BuildError: it failed; with its last lines.
    """
    output = log or subprocess.PIPE
    result = subprocess.run(
        command,
        cwd=cwd,
        check=False,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,
        text=True,
    )
    if result.returncode == 0:
        return "" if log else result.stdout
    told = Path(log.name).read_text() if log else result.stdout
    last = "\n".join(told.strip().splitlines()[-8:])
    raise BuildError(f"{' '.join(command[:2])} failed:\n{last}")


def _succeeds(command: list[str]) -> bool:
    return (
        bool(shutil.which(command[0]))
        and not subprocess.run(command, capture_output=True, check=False).returncode
    )


class Buildah:
    """Builds without a daemon, in a chroot: that asks least of the machine.

    Args:
        logs: Folder for what the builds print.
        manner: How it builds.
    """

    name = "buildah"

    def __init__(self, logs: Path, manner: Manner = Manner()) -> None:
        self._logs = logs
        self._manner = manner

    @staticmethod
    def works() -> bool:
        """Tell whether it can be used here."""
        return _succeeds(["buildah", "images", "-q"])

    def find(self, reference: str) -> Image | None:
        """Return an image, None if it isn't there."""
        result = subprocess.run(
            ["buildah", "inspect", "--type", "image", reference], capture_output=True, text=True, check=False
        )
        if result.returncode:
            return None
        found = json.loads(result.stdout)
        listed = json.loads(run(["buildah", "images", "--json", reference]))
        labels = found["OCIv1"]["config"].get("Labels") or {}
        return Image(f"sha256:{found['FromImageID']}", _bytes(listed[0]["size"]), labels)

    def pull(self, reference: str) -> bool:
        """Get an image from its registry; False if that can't be."""
        return _succeeds(["buildah", "pull", "-q", f"docker.io/library/{reference}"])

    def build(self, recipe: Recipe, base: str, labels: dict[str, str]) -> None:
        """Build an image and tag it, reaching the package registries as this machine does."""
        command = ["buildah", "bud", "--no-cache" if self._manner.fresh else "--layers", "--force-rm"]
        command += ["--isolation", "chroot", "--build-arg", f"BASE={base}"]
        if self._manner.timestamp is not None:
            command += ["--timestamp", str(self._manner.timestamp)]
        for path in (AUTHORITIES, PIP_SETTINGS):
            command += ["--volume", f"{path}:{path}:ro"] if path.exists() else []
        for key, value in labels.items():
            command += ["--label", f"{key}={value}"]
        command += ["-f", str(recipe.dockerfile), "-t", recipe.reference, str(recipe.context)]
        earlier = self.find(recipe.reference)
        with (self._logs / f"{recipe.name}.log").open("w") as log:
            run(command, log=log)
        built = self.find(recipe.reference)
        if earlier and built and earlier.identity != built.identity:
            # Nobody asks for it by name any more; where something still needs it, it stays.
            _succeeds(["buildah", "rmi", earlier.identity.removeprefix("sha256:")])

    def archive(self, reference: str, path: Path) -> None:
        """Write an image to a file; the format without compression takes a third of the time."""
        run(["buildah", "push", "-q", reference, f"docker-archive:{path}:{reference}"])

    def files(self, reference: str, wanted: Callable[[str], bool]) -> Iterator[tuple[str, bytes]]:
        """Yield the path, without a leading slash, and the content of an image's files."""
        with self._mounted(reference) as root:
            for folder, _, names in os.walk(root):
                for name in names:
                    path = Path(folder) / name
                    inside = path.relative_to(root).as_posix()
                    if wanted(inside) and path.is_file() and not path.is_symlink():
                        yield inside, path.read_bytes()

    @contextmanager
    def _mounted(self, reference: str) -> Iterator[Path]:
        # A name of its own: others make containers of the same image, and remove theirs.
        container = f"slamhive-build-{uuid.uuid4().hex}"
        run(["buildah", "from", "--pull-never", "--name", container, reference])
        try:
            yield Path(run(["buildah", "mount", container]).strip())
        finally:
            run(["buildah", "rm", container])


class Docker:
    """Builds by the Docker daemon.

    Args:
        logs: Folder for what the builds print.
        manner: How it builds.

    Raises:
        BuildError: files were to have one time, which builders of docker do in ways of their own.
    """

    name = "docker"

    def __init__(self, logs: Path, manner: Manner = Manner()) -> None:
        if manner.timestamp is not None:
            raise BuildError("--timestamp takes buildah: images/build --tool buildah")
        self._logs = logs
        self._manner = manner

    @staticmethod
    def works() -> bool:
        """Tell whether its daemon answers: the command alone says nothing."""
        return _succeeds(["docker", "info"])

    def find(self, reference: str) -> Image | None:
        """Return an image, None if it isn't there."""
        result = subprocess.run(
            ["docker", "image", "inspect", reference], capture_output=True, text=True, check=False
        )
        if result.returncode:
            return None
        (found,) = json.loads(result.stdout)
        return Image(found["Id"], found["Size"], found["Config"].get("Labels") or {})

    def pull(self, reference: str) -> bool:
        """Get an image from its registry; False if that can't be."""
        return _succeeds(["docker", "pull", "-q", reference])

    def build(self, recipe: Recipe, base: str, labels: dict[str, str]) -> None:
        """Build an image and tag it."""
        command = ["docker", "build", "--build-arg", f"BASE={base}"]
        command += ["--no-cache"] if self._manner.fresh else []
        for key, value in labels.items():
            command += ["--label", f"{key}={value}"]
        command += ["-f", str(recipe.dockerfile), "-t", recipe.tag, str(recipe.context)]
        with (self._logs / f"{recipe.name}.log").open("w") as log:
            run(command, log=log)

    def archive(self, reference: str, path: Path) -> None:
        """Write an image to a file."""
        run(["docker", "save", "-o", str(path), reference])

    def files(self, reference: str, wanted: Callable[[str], bool]) -> Iterator[tuple[str, bytes]]:
        """Yield the path, without a leading slash, and the content of an image's files."""
        container = run(["docker", "create", reference]).strip().splitlines()[-1]
        try:
            with subprocess.Popen(["docker", "export", container], stdout=subprocess.PIPE) as process:
                stream = cast("IO[bytes]", process.stdout)
                with tarfile.open(fileobj=stream, mode="r|") as archive:
                    for entry in archive:
                        content = (
                            archive.extractfile(entry) if entry.isfile() and wanted(entry.name) else None
                        )
                        if content:
                            yield entry.name, content.read()
        finally:
            run(["docker", "rm", container])


def _bytes(text: str) -> int:
    """Read a size as buildah prints it: 382 MB."""
    number, _, unit = text.partition(" ")
    return int(float(number) * {"B": 1, "KB": 1e3, "MB": 1e6, "GB": 1e9}[unit.upper()])


def machine() -> str:
    """Return the architecture of this machine as images name it; what is built here is for it."""
    return {"x86_64": "amd64", "aarch64": "arm64"}.get(platform.machine(), platform.machine())


def choose(name: str | None, logs: Path, manner: Manner = Manner()) -> Tool:
    """Return the program to build with.

    Args:
        name: `docker` or `buildah`; None takes what works.
        logs: Folder for what the builds print.
        manner: How it builds.

    Raises:
        BuildError: none works here.
    """
    kinds: dict[str, type[Docker | Buildah]] = {"docker": Docker, "buildah": Buildah}
    for kind in kinds.values() if name is None else [kinds[name]]:
        if kind.works():
            logs.mkdir(parents=True, exist_ok=True)
            return kind(logs, manner)
    if name is not None:
        raise BuildError(f"{name} doesn't work here: `{name} info` says why")
    raise BuildError(
        "it takes a Docker daemon that answers (docker info), or buildah: apt-get install buildah debootstrap"
    )
