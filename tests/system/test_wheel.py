# SPDX-License-Identifier: Apache-2.0
"""The wheels alone, in environments of their own and far from the checkout, do what the checkout does."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.home.catalog import load_workshop

if TYPE_CHECKING:
    from slamhive.local.home.folder import Home

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ROOT = Path(__file__).parents[2]
NO_NETWORK = ("error sending request", "Temporary failure in name resolution")
UV = Path(sys.prefix) / "bin" / "uv"


def clean() -> dict[str, str]:
    """Return an environment in which nothing points to the checkout."""
    return {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}


def uv(*arguments: str | Path) -> str:
    result = subprocess.run([UV, *arguments], capture_output=True, text=True, env=clean(), check=False)
    if result.returncode and any(words in result.stderr for words in NO_NETWORK):
        pytest.skip("the package registry can't be reached: the wheel's dependencies can't be installed")
    assert result.returncode == 0, result.stderr[-2000:]
    return result.stdout


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheels of both distributions."""
    folder = tmp_path_factory.mktemp("wheels")
    for source in (ROOT, ROOT / "evaluator"):
        uv("build", "--quiet", "--wheel", "--out-dir", folder, source)
    return folder


def install(folder: Path, *wheels: Path) -> Path:
    """Make an environment with these wheels and what they need; return the folder of its programs."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True, env=clean())
    uv("pip", "install", "--quiet", "--python", folder / "bin" / "python", *wheels)
    return folder / "bin"


@pytest.fixture(scope="module")
def installed(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs of an environment with both distributions."""
    return install(tmp_path_factory.mktemp("both"), *wheels.glob("*.whl"))


@pytest.fixture(scope="module")
def evaluator(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs of an environment with the evaluator's distribution alone."""
    return install(tmp_path_factory.mktemp("evaluator"), *wheels.glob("slamhive_eval-*.whl"))


def call(program: Path, *arguments: str | Path, cwd: Path, home: Path) -> str:
    """Return the output of a program; it must end well."""
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


def test_the_wheel_brings_all_pages(installed: Path) -> None:
    pages = ROOT / "operator" / "slamhive" / "dashboard" / "static"
    there = next(installed.parent.glob("lib/python*/site-packages/slamhive/dashboard/static"))
    names = [
        {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
        for folder in (pages, there)
    ]
    assert names[0] == names[1]
    assert "index.html" in names[0]


def test_the_evaluator_needs_numpy_alone(evaluator: Path, tmp_path: Path) -> None:
    place: Any = {"cwd": tmp_path, "home": tmp_path}
    listed = json.loads(uv("pip", "list", "--format", "json", "--python", evaluator / "python"))
    assert {one["name"] for one in listed} == {"slamhive-eval", "numpy"}
    path = tmp_path / "path.txt"
    path.write_text("".join(f"{k} {k} {k * k / 9} 0 0 0 0 1\n" for k in range(4)))
    words = ("ape", path, path, "--align", "se3", "--json")
    by_script = call(evaluator / "slamhive-eval", *words, **place)
    assert json.loads(by_script)["rmse"] < 1e-9
    assert call(evaluator / "python", "-m", "slamhive_eval", *words, **place) == by_script
    call(evaluator / "slamhive-eval", "report", path, path, "-o", tmp_path / "report.html", **place)
    assert "</script>" in (tmp_path / "report.html").read_text()


def test_both_have_one_version_and_slamhive_asks_for_it(installed: Path, tmp_path: Path) -> None:
    code = (
        "import json, slamhive, slamhive_eval; from importlib.metadata import requires, version;"
        "print(json.dumps([slamhive.__version__, slamhive_eval.__version__, version('slamhive'),"
        "version('slamhive-eval'), [r for r in requires('slamhive') if r.startswith('slamhive-eval=')]]))"
    )
    *versions, asked = json.loads(call(installed / "python", "-c", code, cwd=tmp_path, home=tmp_path))
    assert len(set(versions)) == 1
    assert asked == [f"slamhive-eval=={versions[0]}"]


def test_the_wheel_runs_a_sweep(installed: Path, system: Any, home: Home) -> None:
    place: Any = {"cwd": system.folder, "home": home.path}
    out = call(installed / "slamhive", "run", system.sweep(repetitions=2), **place)
    assert "2 runs: 2 succeeded" in out
    rows = json.loads(call(installed / "slamhive", "results", "export", "--format", "json", **place))
    assert [row["outcome"] for row in rows] == ["Tracked", "Tracked"]
