# SPDX-License-Identifier: Apache-2.0
"""The command images/build."""

from __future__ import annotations

import argparse
import fcntl
import importlib.util
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from building import packages
from building.base import STAND_IN, Bases
from building.digests import write_digests
from building.errors import BuildError
from building.loading import load
from building.recipes import ROOT, Recipe, recipes
from building.tools import Manner, Tool, choose, machine

if TYPE_CHECKING:
    from collections.abc import Sequence

PLACE = ROOT / "dist" / "images"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    known = recipes()
    options = _parser(known).parse_args(arguments)
    try:
        if options.list:
            for recipe in known.values():
                print(f"{recipe.name:18} {recipe.tag}")
            return 0
        if options.digests:
            for name, digest in write_digests(known.values()).items():
                print(f"{name:30} {digest}")
            return 0
        chosen = _chosen(options.names, known)
        PLACE.mkdir(parents=True, exist_ok=True)
        with (PLACE / ".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return _build_all(chosen, options)
    except BuildError as error:
        print(f"images/build: {error}", file=sys.stderr)
        return 1


def _parser(known: dict[str, Recipe]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="images/build",
        description="Build the images with docker or buildah, whichever works; unchanged ones are kept. "
        f"The list of each image's packages (CycloneDX) is written to {PLACE.relative_to(ROOT)}/.",
    )
    names = f"images to build, by name or tag: {', '.join(known)}; default: all but those of the tests"
    load_help = "load them into the test cluster, or else into kind's"
    base = (
        f"base of all instead of each Dockerfile's own; where that can't be had: {STAND_IN}, by debootstrap"
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=names)
    parser.add_argument("--load", action="store_true", help=load_help)
    parser.add_argument("--base", metavar="IMAGE", help=base)
    parser.add_argument(
        "--digests", action="store_true", help="only write the bases' digests of today into the Dockerfiles"
    )
    parser.add_argument("--tool", choices=["docker", "buildah"], help="what to build with")
    fresh = "take nothing that was built before"
    parser.add_argument("--fresh", action="store_true", help=fresh)
    time = "time of all files, s since 1970: two builds are equal; takes buildah"
    parser.add_argument("--timestamp", type=int, metavar="SECONDS", help=time)
    archive = "write NAME-VERSION-MACHINE.tar of each, which docker, podman and containerd load"
    parser.add_argument("--archive", type=Path, metavar="FOLDER", help=archive)
    parser.add_argument("--list", action="store_true", help="only say what images there are")
    return parser


def _chosen(names: list[str], known: dict[str, Recipe]) -> list[Recipe]:
    by_name = {recipe.tag: recipe for recipe in known.values()} | known
    unknown = [name for name in names if name not in by_name]
    if unknown:
        raise BuildError(f"no image {unknown[0]!r}, only {', '.join(known)}")
    return [by_name[name] for name in names] or [recipe for recipe in known.values() if not recipe.extra]


def _build_all(chosen: list[Recipe], options: argparse.Namespace) -> int:
    tool = choose(options.tool, PLACE, Manner(options.fresh, options.timestamp))
    bases = Bases(tool, options.base)
    for name in sorted({recipe.default_base for recipe in chosen}):
        if "@" not in name and not options.base:
            print(f"{name} has no digest, its tag is trusted: images/build --digests", file=sys.stderr)
    failed = 0
    for recipe in chosen:
        try:
            done = _build(tool, bases, recipe, fresh=options.fresh)
            if options.archive:
                options.archive.mkdir(parents=True, exist_ok=True)
                path = options.archive / f"{recipe.file_name}-{machine()}.tar"
                path.unlink(missing_ok=True)
                tool.archive(recipe.reference, path.absolute())
            if options.load:
                done += f", {load(tool, recipe.reference)}"
            print(f"{recipe.tag:42} {done}", flush=True)
        except BuildError as error:
            failed += 1
            print(f"{recipe.tag:42} not built: {error}", file=sys.stderr, flush=True)
    return 1 if failed else 0


def _build(tool: Tool, bases: Bases, recipe: Recipe, *, fresh: bool) -> str:
    start = time.monotonic()
    base, identity = bases.of(recipe)
    labels = recipe.labels(base, identity)
    image = tool.find(recipe.reference)
    if not fresh and image and image.labels.get("io.slamhive.inputs") == labels["io.slamhive.inputs"]:
        done = "is up to date"
    else:
        tool.build(recipe, base, labels)
        image = tool.find(recipe.reference)
        if image is None:
            raise BuildError(f"{tool.name} doesn't know the image that it built")
        done = f"built in {time.monotonic() - start:.0f} s, {image.size / 1e6:.0f} MB"
    listing = PLACE / f"{recipe.file_name}.cdx.json"
    if listing.exists() and image.identity.removeprefix("sha256:") in listing.read_text():
        return done
    if importlib.util.find_spec("cyclonedx") is None:
        return f"{done}, no list of packages: make install brings cyclonedx-python-lib"
    found, distribution = packages.read(tool.files(recipe.reference, packages.wanted))
    listing.write_text(packages.document(recipe, image, found, distribution))
    return f"{done}, {len(found)} packages"
