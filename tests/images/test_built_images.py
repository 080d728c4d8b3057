# SPDX-License-Identifier: Apache-2.0
"""Images really built, by buildah: their size, who runs in them, and what is in them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import uuid
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import pytest
from building.command import PLACE
from building.recipes import ROOT, recipes
from building.tools import Buildah

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = [
    pytest.mark.slow,
    pytest.mark.image,
    pytest.mark.skipif(
        os.geteuid() != 0 or not all(map(shutil.which, ("buildah", "debootstrap"))),
        reason="needs root, and apt-get install buildah debootstrap",
    ),
]
MEGABYTE = 1_000_000
ANSWER = "/tmp/answer"
"""File of the test's own in a container, in which its programs print."""
ADDED = {"evaluator": 150 * MEGABYTE, "shell-algorithm": MEGABYTE, "ros2-player": 275 * MEGABYTE}
"""Bytes that each image may add to its base."""


class Container:
    """A container of an image, in which programs are run as the image says."""

    def __init__(self, name: str) -> None:
        # A name of its own: others make containers of the same image, and remove theirs.
        self.id = f"slamhive-test-{uuid.uuid4().hex}"
        command = ["buildah", "from", "--pull-never", "--name", self.id, recipes()[name].reference]
        subprocess.run(command, check=True, capture_output=True)

    def run(self, *command: str) -> str:
        # On a busy machine buildah may end before it has passed on what the program printed.
        with TemporaryDirectory() as folder:
            answer = Path(folder) / "answer"
            answer.touch()
            answer.chmod(0o666)
            inside = ["sh", "-c", f'"$@" > {ANSWER}', "sh", *command]
            mounted = ["--volume", f"{answer}:{ANSWER}"]
            result = subprocess.run(
                ["buildah", "run", "--isolation", "chroot", *mounted, self.id, "--", *inside],
                check=False,
                capture_output=True,
                text=True,
            )
            assert result.returncode == 0, result.stderr
            return answer.read_text().strip()


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Buildah:
    """The images that are looked at, up to date."""
    command = [sys.executable, ROOT / "images" / "build", "--tool", "buildah", *ADDED]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return Buildah(tmp_path_factory.mktemp("logs"))


@pytest.fixture(params=ADDED)
def container(built: Buildah, request: pytest.FixtureRequest) -> Iterator[Container]:
    made = Container(request.param)
    yield made
    subprocess.run(["buildah", "rm", made.id], check=True, capture_output=True)


@pytest.mark.parametrize(("name", "most"), ADDED.items())
def test_it_adds_little_to_its_base(built: Buildah, name: str, most: int) -> None:
    image = built.find(recipes()[name].reference)
    base = built.find(image.labels["org.opencontainers.image.base.name"]) if image else None
    assert image
    assert base
    assert image.size - base.size < most


def test_nobody_runs_in_it_and_can_change_nothing(container: Container) -> None:
    assert container.run("id", "-u") == "65532"
    assert container.run("pwd") == "/slamhive"
    unread = "-path /proc -prune -o -path /sys -prune -o -path /dev -prune"
    find = f"find / -xdev {unread} -o -writable ! -type l -print 2>/dev/null || true"
    found = container.run("sh", "-c", find).splitlines()
    # buildah gives the working directory to the image's user, docker to root; at run time it is read-only.
    assert set(found) <= {"/tmp", "/var/tmp", "/run/lock", "/slamhive", ANSWER}


def test_the_evaluator_has_what_it_needs_and_no_more(built: Buildah) -> None:
    container = Container("evaluator")
    try:
        code = (
            "import json, slamhive_eval, slamhive.analysis, slamhive.model.evaluation, slamhive.jobs;"
            "from importlib.util import find_spec;"
            "unwanted = ('cv2', 'kopf', 'kubernetes', 'sqlalchemy', 'pip');"
            "print(json.dumps([name for name in unwanted if find_spec(name)]))"
        )
        assert json.loads(container.run("python3", "-P", "-c", code)) == []
        cached = "import slamhive_eval as m, pathlib; print(pathlib.Path(m.__cached__).is_file())"
        assert container.run("python3", "-P", "-c", cached) == "True"
    finally:
        subprocess.run(["buildah", "rm", container.id], check=True, capture_output=True)


def test_the_player_of_ros_2_has_what_it_needs_and_no_more(built: Buildah) -> None:
    container = Container("ros2-player")
    try:
        modules = ("node", "bags", "wire")
        code = (
            f"import {', '.join(f'slamhive.playback.player.ros2.{module}' for module in modules)};"
            "from importlib.util import find_spec;"
            "print([name for name in ('pip', 'pydantic', 'slamhive.model') if find_spec(name)])"
        )
        assert container.run("python3", "-P", "-c", code) == "[]"
        assert container.run("sh", "-c", "command -v pip cc gcc cmake || echo none") == "none"
    finally:
        subprocess.run(["buildah", "rm", container.id], check=True, capture_output=True)


@pytest.mark.usefixtures("built")
def test_its_packages_are_listed() -> None:
    from cyclonedx.schema import SchemaVersion  # takes two seconds
    from cyclonedx.validation.json import JsonStrictValidator

    text = (PLACE / f"evaluator-{recipes()['evaluator'].tag.partition(':')[2]}.cdx.json").read_text()
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    names = {part["name"] for part in json.loads(text)["components"]}
    assert {"slamhive", "slamhive-eval", "numpy", "libc6"} <= names
