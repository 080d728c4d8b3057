# SPDX-License-Identifier: Apache-2.0
"""The files of a release, made twice from the commit and compared byte by byte: make release.

Both times it is a copy of the commit in a folder of its own, with its own times and nothing built before, so
that neither place, day nor leftovers decide. Images are for this machine's architecture.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import importlib.metadata
import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from email.parser import HeaderParser
from pathlib import Path

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.component import Component, ComponentType
from packageurl import PackageURL
from packaging.requirements import Requirement
from release_checks import CHARTS, ROOT, Changes, changes, git, problems, version

sys.path += [str(ROOT / "images"), str(ROOT / "tests" / "cluster")]

from building.packages import Package, listing
from building.tools import machine
from testcluster import programs
from testcluster.errors import ClusterError

PLACE = ROOT / "dist" / "release"
SUMS = "SHA256SUMS"
IMAGES = ["slamhive", "evaluator", "ros1-player"]
if machine() == "amd64":
    IMAGES.append("ros2-player")  # whose wheels are for that alone
DISTRIBUTIONS = {"slamhive-eval": "evaluator", "slamhive": "."}
"""Folders of the distributions, in the order in which they are uploaded."""


def say(text: str) -> None:
    """Write a line at once: builds take minutes."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def complain(text: str) -> None:
    """Write a line about what is in the way."""
    sys.stderr.write(f"{text}\n")


def run(*command: str | Path, cwd: Path | None = None, env: dict[str, str] | None = None) -> None:
    """Run a program; one that fails ends the release with its last lines."""
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=os.environ | (env or {}),
        check=False,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    if done.returncode:
        words = " ".join(str(word) for word in command[:3])
        sys.exit(f"{words} failed:\n" + "\n".join(done.stdout.strip().splitlines()[-15:]))


class Release:
    """Files of a release, each made from a copy of the commit.

    Args:
        commit: what is released.
        images: names of the container images to build.
    """

    def __init__(self, commit: str, images: list[str]) -> None:
        self._commit = commit
        self._images = images
        self._epoch = int(git(ROOT, "show", "-s", "--format=%ct", commit))

    def make(self, work: Path) -> Path:
        """Make all files in a folder and return where they are."""
        source, out = work / "source", work / "files"
        source.mkdir(parents=True)
        out.mkdir()
        content = subprocess.run(
            ["git", "-c", "safe.directory=*", "-C", ROOT, "archive", self._commit],
            check=True,
            capture_output=True,
        ).stdout
        with tarfile.open(fileobj=io.BytesIO(content)) as archive:
            archive.extraction_filter = getattr(tarfile, "tar_filter", None)  # Python 3.11.4 has it
            archive.extractall(source)  # noqa: S202 - an archive of our own
        self._distributions(source, out)
        self._charts(source, out)
        self._container_images(source, out)
        (out / "CHANGES.md").write_text(changes(source).text)
        return out

    def _distributions(self, source: Path, out: Path) -> None:
        (out / "sbom").mkdir()
        for name, folder in DISTRIBUTIONS.items():
            words = ("-m", "hatchling", "build", "--directory", out)
            run(sys.executable, *words, cwd=source / folder, env={"SOURCE_DATE_EPOCH": str(self._epoch)})
            wheel = next(out.glob(f"{name.replace('-', '_')}-[0-9]*.whl"))
            target = out / "sbom" / f"{name}-{version(source)}.cdx.json"
            target.write_text(distribution_listing(wheel))

    def _charts(self, source: Path, out: Path) -> None:
        (out / "charts").mkdir()
        pack_charts(find_helm(), source, out / "charts", self._epoch)

    def _container_images(self, source: Path, out: Path) -> None:
        if not self._images:
            return
        words = ["--tool", "buildah", "--fresh", "--timestamp", str(self._epoch)]
        words += ["--archive", str(out / "images"), *self._images]
        run(sys.executable, source / "images" / "build", *words)
        for path in sorted((source / "dist" / "images").glob("*.cdx.json")):
            shutil.copyfile(path, out / "sbom" / f"image-{path.name}")


def distribution_listing(wheel: Path) -> str:
    """Return the CycloneDX document of a wheel: what it needs, in the versions that its tests ran with."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (one for one in archive.namelist() if one.endswith(".dist-info/METADATA"))
        told = HeaderParser().parsestr(archive.read(name).decode())
    content = hashlib.sha256(wheel.read_bytes()).hexdigest()
    url = PackageURL("pypi", None, told["Name"], told["Version"])
    root = Component(
        name=told["Name"],
        version=told["Version"],
        type=ComponentType.APPLICATION,
        purl=url,
        bom_ref=url.to_string(),
        description=told["Summary"],
        licenses=[LicenseFactory().make_from_string(told["License-Expression"])],
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=content)],
    )
    return listing(root, f"{url.to_string()}#{content}", needed(told.get_all("Requires-Dist") or []))


def needed(requirements: list[str]) -> list[Package]:
    """Return the packages that requirements bring, all in all, as they are installed here."""
    found: dict[str, Package] = {}
    seen: set[tuple[str, str]] = set()
    left = [(Requirement(line), "") for line in requirements]
    while left:
        asked, extra = left.pop()
        if asked.marker is not None and not asked.marker.evaluate({"extra": extra}):
            continue
        told = importlib.metadata.metadata(asked.name)
        name = asked.name.lower().replace("_", "-")
        licence = "".join(told.get_all("License-Expression") or [])
        found[name] = Package("pypi", name, told["Version"], license=licence)
        for wanted in ("", *sorted(asked.extras)):
            if (name, wanted) not in seen:
                seen.add((name, wanted))
                lines = importlib.metadata.requires(asked.name) or []
                left += [(Requirement(line), wanted) for line in lines]
    return sorted(found.values())


def find_helm() -> str:
    """Return helm: of $HELM, the path, or built as the test cluster's programs are."""
    found = os.environ.get("HELM") or shutil.which("helm")
    if found is None:
        try:
            programs.build(("helm",))
        except ClusterError as error:
            sys.exit(f"no helm, and it can't be built: {error}")
        found = str(programs.path_of("helm"))
    return found


def pack_charts(helm: str | Path, source: Path, out: Path, moment: int) -> dict[str, Path]:
    """Write the archives of a tree's charts, and return them by the charts' names.

    Args:
        helm: the program.
        source: the tree.
        out: folder for the archives.
        moment: time of all that is in them.
    """
    found = {}
    for chart in CHARTS:
        with tempfile.TemporaryDirectory() as folder:
            run(helm, "package", source / "helm" / chart, "--destination", folder)
            made = next(Path(folder).glob("*.tgz"))
            found[chart] = out / made.name
            repack(made, found[chart], moment)
    return found


def repack(chart: Path, target: Path, moment: int) -> None:
    """Write a chart's archive anew, in a fixed order and with one time: helm writes that of now."""
    with (
        tarfile.open(chart) as packed,
        target.open("wb") as file,
        gzip.GzipFile("", "wb", 9, file, mtime=moment) as squeezed,
        tarfile.open(fileobj=squeezed, mode="w", format=tarfile.USTAR_FORMAT) as made,
    ):
        for entry in sorted(packed.getmembers(), key=lambda one: one.name):
            clean = tarfile.TarInfo(entry.name)
            clean.size, clean.mode, clean.mtime = entry.size, 0o644, moment
            made.addfile(clean, packed.extractfile(entry))


def sums(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of all files of a folder, by path."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != SUMS:
            with path.open("rb") as file:
                found[path.relative_to(folder).as_posix()] = hashlib.file_digest(file, "sha256").hexdigest()
    return found


def differences(first: dict[str, str], second: dict[str, str]) -> list[str]:
    """Return the files that are not the same in two makings."""
    return sorted(name for name in first.keys() | second.keys() if first.get(name) != second.get(name))


def release(images: list[str]) -> int:
    """Make a release and return the exit code."""
    begun = time.monotonic()
    found = list(problems())
    for problem in found:
        complain(f"no release: {problem}")
    if found:
        return 2
    change: Changes = changes(ROOT)
    name = version(ROOT) if change.released else f"{version(ROOT)}-unreleased"
    target = PLACE / name
    maker = Release(git(ROOT, "rev-parse", "HEAD").strip(), images)
    PLACE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=PLACE, prefix=".making.", ignore_cleanup_errors=True) as work:
        made = []
        for number in ("first", "second"):
            made.append(maker.make(Path(work) / number))
            say(f"{number} making: {len(sums(made[-1]))} files, {time.monotonic() - begun:.0f} s")
        first, second = map(sums, made)
        different = differences(first, second)
        if different:
            kept = PLACE / "different"
            shutil.rmtree(kept, ignore_errors=True)
            Path(work).rename(kept)
            complain(f"not equal, both are in {kept}: {', '.join(different)}")
            return 1
        (made[0] / SUMS).write_text("".join(f"{digest}  {path}\n" for path, digest in first.items()))
        shutil.rmtree(target, ignore_errors=True)
        made[0].rename(target)
    for path, digest in first.items():
        size = (target / path).stat().st_size
        say(f"{digest[:16]}  {size / 1e6:9.3f} MB  {path}")
    say(f"{target}: made twice, equal byte for byte, {time.monotonic() - begun:.0f} s")
    if change.released is None:
        say(f"CHANGELOG.md has no section {version(ROOT)} yet: this is for trying, not to be published")
    return 0


def main() -> int:
    """Run the command and return its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    text = f"of container images, or none; default: {' '.join(IMAGES)}"
    parser.add_argument("images", nargs="*", metavar="NAME", help=text)
    asked = parser.parse_args().images
    return release([] if asked == ["none"] else asked or IMAGES)


if __name__ == "__main__":
    sys.exit(main())
