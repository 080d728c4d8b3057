# SPDX-License-Identifier: Apache-2.0
"""A home with a small dataset and an algorithm that does what its parameter says."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling

from slamhive.data.store import materialise
from slamhive.local.home import Home
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file

TESTS = Path(__file__).parent
ACTOR = TESTS / "actor"
FIRST = ("e2e", "kube/reconciling", "kube/faults", "shows", "system", "local", "helm", "cluster")
"""Folders whose tests take longest."""
ON_NODE = ("tests/e2e/", "tests/helm/test_cluster.py", "tests/cluster/test_local.py")


class Sharing(LoadScopeScheduling):
    """What workers side by side share out: whole files, and all that needs a node together."""

    def _split_scope(self, nodeid: str) -> str:
        path = nodeid.partition("::")[0]
        return "node" if path.startswith(ON_NODE) else path


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Sharing:
    """Share tests out in our way."""
    return Sharing(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes longest, so that it doesn't end last."""

    def rank(item: pytest.Item) -> int:
        folder = item.path.parent.relative_to(TESTS).as_posix()
        return FIRST.index(folder) if folder in FIRST else len(FIRST)

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
