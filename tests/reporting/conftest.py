# SPDX-License-Identifier: Apache-2.0
"""Archives with runs of every sort, the published runs, and the commands of this folder."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.cli.main import main
from slamhive.local.home.folder import lock
from slamhive.model.results import Outcome, Phase, Reason, Result, RunRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import ModuleType

TESTS = Path(__file__).parents[1]
HTML = "</td><script>alert(1)</script> & \"'"
LONG = "ü" * 10_000


def of_file(name: str, path: Path) -> ModuleType:
    """Return a module of another folder of tests."""
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


@pytest.fixture(scope="session")
def rerun_packages() -> Path:
    """A folder with Rerun that outlives the session: 500 MB, in half a minute."""
    listed = Path(__file__).with_name("rerun.txt")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slamhive-tests"
    folder = cache / f"rerun-{hashlib.sha256(listed.read_bytes()).hexdigest()[:8]}"
    with lock(cache / "rerun.lock"):
        if not folder.exists():
            made = folder.with_suffix(".making")
            words = ["pip", "install", "--quiet", "--python", sys.executable, "--target", made]
            words += ["--no-deps", "--require-hashes", "-r", listed]
            try:
                subprocess.run(
                    [Path(sys.prefix) / "bin" / "uv", *words], check=True, capture_output=True, timeout=600
                )
            except (OSError, subprocess.SubprocessError) as error:
                shutil.rmtree(made, ignore_errors=True)
                pytest.skip(f"Rerun can't be installed here: {getattr(error, 'stderr', error)}")
            made.rename(folder)
    return folder


@pytest.fixture
def rerun(rerun_packages: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Makes Rerun's library importable; runs its own command on files and returns what it says."""
    monkeypatch.syspath_prepend(rerun_packages)

    def call(*words: str | Path) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "rerun", "rrd", *words],
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {"PYTHONPATH": str(rerun_packages)},
        )
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    return call


def result(evaluation: str = "se3", outcome: Outcome = Outcome.TRACKED, **values: Any) -> Result:
    given = {"alignment": evaluation, "ate": {"rmse": 0.1}, "rpe": [{"rmse": 0.01}], "scale": 1.0}
    return Result(evaluation=evaluation, outcome=outcome, coverage=0.95, values=given | values)


def run(number: int, **changes: Any) -> RunRecord:
    """Return a run of two algorithms on three datasets; ``spec`` and ``parameters`` may be changed."""
    algorithm, dataset = number % 2, number // 2 % 3
    spec = {
        "algorithmRef": {"name": f"algorithm-{algorithm}"},
        "datasetRef": {"name": f"dataset-{dataset}"},
        "sensors": "stereo",
        "parameters": changes.pop("parameters", {"nFeatures": 500 * (1 + number // 6 % 2)}),
        "input": {"pace": "Lockstep"},
        "repetition": number // 12,
        "seed": number,
    } | changes.pop("spec", {})
    error = 0.02 * (1 + algorithm) + 0.01 * dataset + 0.001 * (number // 12)
    fields: dict[str, Any] = {
        "uid": f"uid-{number:03d}",
        "name": f"run-{number:03d}",
        "sweep": "study" if number < 24 else "later",
        "spec": spec,
        "phase": Phase.SUCCEEDED,
        "started": f"2026-01-02T03:04:{number % 60:02d}.25Z",
        "finished": f"2026-01-02T03:05:{number % 60:02d}Z",
        "usage": {
            "cpu": {"meanCores": 1.5 + algorithm, "secondsPerDataSecond": 0.5 + 0.01 * number},
            "memory": {"peakBytes": 2**28 + number * 2**20},
            "wallSeconds": 20.0,
        },
        "results": [result(ate={"rmse": error})],
    }
    return RunRecord.model_validate(fields | changes)


def meant(*names: str) -> list[dict[str, str]]:
    """Return the evaluations that a run was meant to be measured by."""
    return [{"evaluation": name, "alignment": name} for name in names]


def failed(number: int, **changes: Any) -> RunRecord:
    more: dict[str, Any] = {
        "evaluations": meant("se3"),
        "phase": Phase.FAILED,
        "reason": Reason.OUT_OF_MEMORY,
        "results": [],
        "usage": None,
    }
    return run(number, **(more | changes))


ASSORTED = (
    *(run(number) for number in range(24)),
    failed(24),
    run(25, results=[result(outcome=Outcome.LOST), result("sim3")]),
    run(26, results=[]),
    run(27, name="run-html", parameters={"text": HTML}, spec={"algorithmRef": {"name": HTML}}),
    run(28, parameters={"nFeatures": "many", "long": LONG}, spec={"datasetRef": {"name": LONG}}),
    run(29, parameters={"nFeatures": None, "nested": {"a": [1, 2]}}, message="it ended\nbadly\x00"),
)


@pytest.fixture
def fill(tmp_path: Path) -> Callable[[Iterable[RunRecord]], Path]:
    """Write runs into a fresh home, and return it."""

    def write(records: Iterable[RunRecord]) -> Path:
        with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
            archive.put_runs(records)
        return tmp_path

    return write


@pytest.fixture
def assorted(fill: Callable[[Iterable[RunRecord]], Path]) -> Path:
    return fill(ASSORTED)


@pytest.fixture(scope="session")
def published(paper_home: Callable[..., Path]) -> Path:
    """A home with the 81 runs of the original paper."""
    return paper_home("sim3")


@pytest.fixture
def slamhive(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """The command on a home: returns its exit code, its output and its complaints."""

    def call(home: Path, *words: Any) -> tuple[int, str, str]:
        monkeypatch.setenv("SLAMHIVE_HOME", str(home))
        monkeypatch.setenv("SLAMHIVE_ARCHIVE", "")
        monkeypatch.setattr("sys.argv", ["slamhive", *map(str, words)])
        capsys.readouterr()
        code = 0
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        return (code, *capsys.readouterr())

    return call


@pytest.fixture
def records() -> Any:
    """Module with the functions that make records."""
    return sys.modules[__name__]
