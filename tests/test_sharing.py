# SPDX-License-Identifier: Apache-2.0
"""Tests of how tests are shared out: all are run once and told of, whatever workers do."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from units import SPLIT_SECONDS, Durations, Units

CONFTEST = f"""
import sys, pytest
from pathlib import Path
sys.path.append({str(Path(__file__).parent)!r})
from sharing import Sharing
from units import Durations, Units
def pytest_configure(config):
    durations = Durations(Path("seconds.json"))
    config.pluginmanager.register(Sharing(2, durations, Units(durations)))
@pytest.fixture(scope="session")
def journal():
    yield
    with open("journal", "a") as file: file.write("ended\\n")
"""
TESTS = {
    "fine": "import pytest\n@pytest.mark.parametrize('k', range(20))\ndef test_fine(journal, k): print('s')",
    "wrong": "def test_wrong(journal):\n    print('told', 'of')\n    assert 1 == 2",
    "dead": "import os\ndef test_before(): pass\ndef test_dead(): os._exit(9)\ndef test_after(): pass",
}


def run(folder: Path, *words: str) -> str:
    """Run the tests of a folder and return what is printed."""
    (folder / "conftest.py").write_text(CONFTEST)
    for name, text in TESTS.items():
        (folder / f"test_{name}.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir=."]
    env = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    ended = subprocess.run(
        [*command, *words], cwd=folder, env=env, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1, ended.stdout + ended.stderr
    return ended.stdout


@pytest.mark.slow
def test_every_test_is_run_once_and_what_fails_is_told(tmp_path: Path) -> None:
    told = run(tmp_path)
    assert "2 failed, 22 passed" in told
    assert "the worker that ran this ended with 9" in told
    assert "told of" in told
    assert "Captured stdout call" in told
    # The one that died tore nothing down; the one after it made nothing.
    assert set((tmp_path / "journal").read_text().splitlines()) == {"ended"}
    kept = json.loads((tmp_path / "seconds.json").read_text())
    assert len(kept) == 24


def test_the_first_failure_ends_all_where_that_is_asked_for(tmp_path: Path) -> None:
    assert "1 failed" in run(tmp_path, "-x", "test_wrong.py", "test_fine.py")
    assert (tmp_path / "journal").read_text().splitlines() == ["ended"] * 2


class Item:
    """A test, with what units ask of one."""

    def __init__(self, name: str, *markers: str) -> None:
        self.nodeid = name
        self._markers = [getattr(pytest.mark, marker).mark for marker in markers]

    def iter_markers(self) -> list[pytest.Mark]:
        return self._markers

    def get_closest_marker(self, name: str) -> pytest.Mark | None:
        return next((mark for mark in self._markers if mark.name == name), None)


def units(tmp_path: Path, seconds: dict[str, float], *items: Item) -> Units:
    path = tmp_path / "seconds.json"
    path.write_text(json.dumps(seconds))
    found = Units(Durations(path))
    found.make(items)  # type: ignore[arg-type]
    return found


def test_what_took_longest_goes_first_and_is_divided(tmp_path: Path) -> None:
    long, quick = "tests/long.py", "tests/quick.py"
    took = {f"{long}::a": 1.0, f"{long}::b": SPLIT_SECONDS, f"{quick}::a": 0.1, f"{quick}::b": 0.1}
    found = units(tmp_path, took, *map(Item, reversed(took)), Item("tests/e2e/new.py::a", "slow"))
    order = [found.next(1, 2).name for _ in range(len(found.waiting))]
    assert order[:2] == ["tests/e2e/", f"{long}::b"]
    assert set(order[2:]) == {f"{long}::a", quick}


def test_two_workers_have_clusters_and_the_others_what_is_left(tmp_path: Path) -> None:
    clusters = [Item(f"tests/kube/{name}.py::a", "cluster") for name in "abcd"]
    others = [Item(f"tests/plan/{name}.py::a") for name in "abcd"]
    found = units(tmp_path, {}, *others, *clusters)
    taken = [(worker, found.next(worker, 4).on_cluster) for worker in (1, 2, 3, 4, 1, 3, 2, 4)]
    assert taken == [(worker, worker < 3) for worker, _ in taken]
    assert found.waiting == []
