# SPDX-License-Identifier: Apache-2.0
"""The images that there are, and what each is made of."""

from __future__ import annotations

import fnmatch
import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from building.errors import BuildError

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[2]
_COPY = re.compile(r"^COPY (?!--from)(?P<words>.+)$", re.MULTILINE)
_COMPILED = ("__pycache__", "*.pyc")


@dataclass(frozen=True)
class Recipe:
    """Build instructions of a container image: its name and tag, Dockerfile and context.

    Attributes:
        name: What the command line calls it: the folder's name.
        tag: Name and version of the image, such as `slamhive/kiss-icp:1.3.0`.
        dockerfile: Its Dockerfile.
        context: The folder that the Dockerfile copies from.
        title: One sentence on what is in it.
        license: Licences of what is in it besides the base, as an SPDX expression.
        extra: Whether it serves the tests alone.
    """

    name: str
    tag: str
    dockerfile: Path
    context: Path
    title: str
    license: str
    extra: bool = False

    @property
    def reference(self) -> str:
        """The name under which the kubelet looks for the tag."""
        return f"docker.io/{self.tag}"

    @property
    def file_name(self) -> str:
        """Begin of the names of files about it."""
        return self.tag.partition("/")[2].replace(":", "-")

    @property
    def default_base(self) -> str:
        """The base that the Dockerfile names."""
        found = re.search(r"^ARG BASE=(\S+)$", self.dockerfile.read_text(), re.MULTILINE)
        if not found:
            raise BuildError(f"{self.dockerfile}: no line ARG BASE=image in it")
        return found[1]

    def sources(self) -> list[Path]:
        """Return the files that the Dockerfile copies, in a fixed order.

        Raises:
            BuildError: one of them is not there.
        """
        text = self.dockerfile.read_text().replace("\\\n", " ")
        named = [self.context / word for line in _COPY.finditer(text) for word in line["words"].split()[:-1]]
        for path in named:
            if not path.exists():
                raise BuildError(f"{self.dockerfile}: it copies {path}, which is not there")
        return sorted({file for path in named for file in _files(path)})

    def digest(self, base: str) -> str:
        """Return a hash of all that goes into the image; it changes whenever the image would.

        Args:
            base: Name and identity of the base image.
        """
        total = hashlib.sha256(f"{self.tag}\n{base}\n{self.title}\n{self.license}\n".encode())
        for path in [self.dockerfile, *self.sources()]:
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            total.update(f"{path.relative_to(ROOT)} {path.stat().st_mode & 0o111:o} {content}\n".encode())
        return total.hexdigest()

    def labels(self, base: str, identity: str) -> dict[str, str]:
        """Return the labels of the image, given name and identity of its base."""
        return {
            "org.opencontainers.image.title": self.tag.partition(":")[0],
            "org.opencontainers.image.version": self.tag.partition(":")[2],
            "org.opencontainers.image.description": self.title,
            "org.opencontainers.image.licenses": self.license,
            "org.opencontainers.image.base.name": base,
            "io.slamhive.inputs": self.digest(f"{base} {identity}"),
        }


def _files(path: Path) -> Iterator[Path]:
    if path.is_file():
        yield path
        return
    for child in path.iterdir():
        if not any(fnmatch.fnmatch(child.name, pattern) for pattern in _COMPILED):
            yield from _files(child)


def recipes() -> dict[str, Recipe]:
    """Return all images by name: those of the product first, the tests' own last."""
    found = [_own(path) for path in sorted((ROOT / "images").glob("*/Dockerfile"))]
    found += [
        _of_algorithm(path, path.parents[1]) for path in sorted(ROOT.glob("images/algorithms/*/Dockerfile"))
    ]
    found += [
        _of_algorithm(path, path.parent, extra=True)
        for path in sorted(ROOT.glob("tests/images/*/Dockerfile"))
    ]
    return {recipe.name: recipe for recipe in found}


def version() -> str:
    """Return the version of slamhive and slamhive-eval."""
    text = (ROOT / "evaluator" / "slamhive_eval" / "__init__.py").read_text()
    return _field(text, r'^__version__ = "(.+)"$', "slamhive_eval/__init__.py: __version__")


def _own(dockerfile: Path) -> Recipe:
    name = dockerfile.parent.name
    comments = re.findall(r"^# (.+)$", dockerfile.read_text(), re.MULTILINE)
    return Recipe(name, f"slamhive/{name}:{version()}", dockerfile, ROOT, comments[1], "Apache-2.0")


def _of_algorithm(dockerfile: Path, context: Path, *, extra: bool = False) -> Recipe:
    manifest = dockerfile.parent / "algorithm.yaml"
    text = manifest.read_text()
    image, title, licence = (
        _field(text, rf"^  {key}: (.+)$", f"{manifest}: spec.{key}")
        for key in ("image", "description", "license")
    )
    return Recipe(dockerfile.parent.name, image, dockerfile, context, title, licence, extra)


def _field(text: str, pattern: str, where: str) -> str:
    found = re.search(pattern, text, re.MULTILINE)
    if not found:
        raise BuildError(f"{where} is missing")
    return found[1].strip()
