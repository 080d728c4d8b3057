# SPDX-License-Identifier: Apache-2.0
"""A home with a small dataset and an algorithm that does what its parameter says."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from slamhive.data.store import materialise
from slamhive.local.home import Home
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file

TESTS = Path(__file__).parent
ACTOR = TESTS / "actor"
FIRST = ("e2e", "kube/reconciling", "kube/faults", "shows", "system", "local", "helm", "cluster")
"""Folders whose tests take longest: begun first, they don't end last."""


@pytest.hookimpl(tryfirst=True)  # before the workers take note of groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Say what side-by-side workers share out: files, and all that needs a node together."""

    def rank(item: pytest.Item) -> int:
        folder = item.path.parent.relative_to(TESTS).as_posix()
        return FIRST.index(folder) if folder in FIRST else len(FIRST)

    for item in items:
        on_node = {"node_cluster", "local_cluster"} & set(getattr(item, "fixturenames", ()))
        group = "node" if on_node else item.path.relative_to(TESTS).as_posix()
        item.add_marker(pytest.mark.xdist_group(group))
    items.sort(key=rank)


@pytest.fixture(scope="session")
def environments(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of environments that all homes share, as making one takes seconds."""
    return tmp_path_factory.mktemp("environments")


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of datasets in which the small recording has been made."""
    folder = tmp_path_factory.mktemp("datasets")
    dataset = load_file(ACTOR / "tiny.yaml")[0]
    assert isinstance(dataset, Dataset)
    materialise(dataset, folder, folder)
    (folder / "tiny").mkdir()
    shutil.copyfile(ACTOR / "tiny.yaml", folder / "tiny" / "dataset.yaml")
    return folder


@pytest.fixture
def home(tmp_path: Path, environments: Path, tiny: Path) -> Home:
    """A home of its own for each test, with the small dataset and the actor."""
    folder = tmp_path / "home"
    actor = folder / "algorithms" / "actor"
    actor.mkdir(parents=True)
    (folder / "environments").symlink_to(environments)
    (folder / "datasets").symlink_to(tiny)
    for name in ("algorithm.yaml", "adapter.py", "requirements.txt"):
        shutil.copyfile(ACTOR / name, actor / name)
    truth = next(tiny.glob("tiny-*/groundtruth.txt")).read_text()
    (actor / "truth.txt").write_text("".join(line + "\n" for line in truth.splitlines() if line[0] != "#"))
    shutil.copyfile(ACTOR / "tiny.yaml", folder / "tiny.yaml")
    return Home.at(folder)
