# SPDX-License-Identifier: Apache-2.0
"""Environment of `make demo`: enough for what the README shows, and what isn't there says how to have it."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from checkout import make_environment

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.folder import Home

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs of the environment that `make demo` makes."""
    folder = tmp_path_factory.mktemp("demo") / ".venv"
    make_environment(folder, "demo")
    return folder / "bin"


@pytest.fixture
def call(programs: Path, system: Any, home: Home) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs a program of that environment, in the folder of a home with two finished runs."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    variables |= {"SLAMHIVE_HOME": str(home.path), "COLUMNS": "200"}

    def run(name: str, *words: str | Path) -> subprocess.CompletedProcess[str]:
        command = [programs / name, *words]
        found = subprocess.run(
            command, cwd=system.folder, env=variables, capture_output=True, text=True, check=False
        )
        assert "Traceback" not in found.stderr
        return found

    assert run("slamhive", "run", system.sweep(repetitions=2)).returncode == 0
    return run


def test_reports_tables_and_figures_are_there(call: Callable, system: Any) -> None:
    for words in (
        "results table --sweep s",
        "results export --sweep s --format csv",
        "report --sweep s -o s.html",
        "paper-table --sweep s",
        "figure box --sweep s -o s.pdf",
        "doctor",
    ):
        done = call("slamhive", *words.split())
        assert done.returncode == 0, (words, done.stdout, done.stderr)
    assert (system.folder / "s.pdf").read_bytes().startswith(b"%PDF")


def test_the_dashboard_is_there(call: Callable) -> None:
    # It would serve for ever: all that it imports is there, and an address that nobody has is refused.
    done = call("slamhive", "dashboard", "--host", "192.0.2.1", "--port", "0")
    assert done.returncode == 2
    assert "192.0.2.1" in done.stderr


def test_what_is_not_there_says_how_to_have_it(call: Callable) -> None:
    for words, extra in (
        ("results export --sweep s --to tensorboard -o boards", "tensorboard"),
        ("results export --sweep s --to mlflow -o runs", "mlflow"),
        ("status", "cluster"),
    ):
        done = call("slamhive", *words.split())
        assert done.returncode in {1, 2}
        assert f"pip install -e '{ROOT}[{extra}]'" in done.stderr
