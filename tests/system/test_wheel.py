# SPDX-License-Identifier: Apache-2.0
"""The wheel alone, in an environment of its own and far from the checkout, does what the checkout does."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.catalog import load_workshop

if TYPE_CHECKING:
    from slamhive.local.home import Home

ROOT = Path(__file__).parents[2]
NO_NETWORK = ("connection broken", "NewConnectionError", "Temporary failure in name resolution")
PIP = ("-m", "pip", "--no-input", "--disable-pip-version-check")


def clean() -> dict[str, str]:
    """Return an environment in which nothing points to the checkout."""
    return {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}


def pip(python: Path | str, *arguments: str | Path) -> None:
    command = [python, *PIP, *arguments]
    result = subprocess.run(command, capture_output=True, text=True, env=clean(), check=False)
    if result.returncode and any(words in result.stderr for words in NO_NETWORK):
        pytest.skip("the package registry can't be reached: the wheel's dependencies can't be installed")
    assert result.returncode == 0, result.stderr[-2000:]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of an environment into which the wheel was installed."""
    folder = tmp_path_factory.mktemp("wheel")
    pip(sys.executable, "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT)
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True, env=clean())
    programs = folder / "venv" / "bin"
    pip(programs / "python", "install", "--quiet", next(folder.glob("*.whl")))
    return programs


def call(program: Path, *arguments: str | Path, cwd: Path, home: Path) -> str:
    """Return what a program prints; it must end well."""
    environment = clean() | {
        "SLAMHIVE_HOME": str(home),
        "PATH": "/usr/local/bin:/usr/bin:/bin",
        "COLUMNS": "200",
    }
    result = subprocess.run(
        [program, *arguments], capture_output=True, text=True, cwd=cwd, env=environment, check=False
    )
    assert result.returncode == 0, result.stderr
    assert "Traceback" not in result.stderr
    return result.stdout


@pytest.mark.slow
def test_the_wheel_brings_its_catalog_and_examples(installed: Path, tmp_path: Path) -> None:
    place: Any = {"cwd": tmp_path, "home": tmp_path / "home"}
    where = "import slamhive, slamhive_eval; print(slamhive.__file__, slamhive_eval.__file__)"
    assert str(ROOT) not in call(installed / "python", "-c", where, **place)
    names = {
        one["name"]
        for one in json.loads(call(installed / "slamhive", "algorithm", "list", "--json", **place))
    }
    assert names == set(load_workshop().algorithms)
    examples = next(installed.parent.glob("lib/python*/site-packages/slamhive/_bundled/examples"))
    assert call(installed / "slamhive", "plan", "--count", examples / "demo.yaml", **place).strip() == "18"
    assert (
        call(installed / "slamhive", "plan", "--count", examples / "icra2023-80000.yaml", **place)
        == "80000\n"
    )
    assert "18 runs" in call(installed / "slamhive", "validate", examples / "demo.yaml", **place)
    assert "synthetic-lidar" in call(installed / "slamhive", "dataset", "list", **place)


@pytest.mark.slow
def test_the_wheel_brings_all_pages(installed: Path) -> None:
    pages = ROOT / "operator" / "slamhive" / "dashboard" / "static"
    there = next(installed.parent.glob("lib/python*/site-packages/slamhive/dashboard/static"))
    names = [
        {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
        for folder in (pages, there)
    ]
    assert names[0] == names[1]
    assert "index.html" in names[0]


@pytest.mark.slow
def test_the_evaluator_of_the_wheel_stands_alone(installed: Path, tmp_path: Path) -> None:
    assert "usage" in call(installed / "slamhive-eval", "--help", cwd=tmp_path, home=tmp_path).lower()


@pytest.mark.slow
def test_the_wheel_runs_a_sweep(installed: Path, system: Any, home: Home) -> None:
    place: Any = {"cwd": system.folder, "home": home.path}
    out = call(installed / "slamhive", "run", system.sweep(repetitions=2), **place)
    assert "2 runs: 2 succeeded" in out
    rows = json.loads(call(installed / "slamhive", "results", "export", "--format", "json", **place))
    assert [row["outcome"] for row in rows] == ["Tracked", "Tracked"]
