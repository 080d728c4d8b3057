# SPDX-License-Identifier: Apache-2.0
"""Fixtures that render the charts.

Helm is looked for in $HELM, on the PATH and among the test cluster's programs.

``SLAMHIVE_UPDATE=1 pytest tests/helm`` writes what is kept (golden renders and the charts' copies of CRDs and
catalog) instead of comparing it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "cluster"))

from testcluster.fixtures import *  # noqa: E402, F403

CHART = ROOT / "helm" / "slamhive"
CRDS_CHART = ROOT / "helm" / "slamhive-crds"
VALUES = Path(__file__).parent / "values"
VERSION = "1.34.0"
"""Version of Kubernetes to render for: helm built as a Go module doesn't know any."""


def _helm() -> str | None:
    cached = Path.home() / ".cache" / "slamhive-cluster" / "bin" / "helm"
    return os.environ.get("HELM") or shutil.which("helm") or (str(cached) if cached.exists() else None)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Reads as kubectl does: 1e-05 is a number."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9.]+[eE][-+]?[0-9]+$"), [*"-+.0123456789"]
)


@cache
def objects_of(text: str) -> list[dict[str, Any]]:
    """Return the objects of a text."""
    return [one for one in yaml.load_all(text, _Loader) if one]


class Helm:
    """The program, with what it says."""

    def __init__(self, program: str) -> None:
        self.program = program
        self._template = lru_cache(maxsize=None)(self._run_template)

    def run(self, *words: str, code: int = 0) -> str:
        """Run it; returns stdout, or stderr where it is to fail."""
        done = subprocess.run([self.program, *words], capture_output=True, text=True, check=False)
        assert done.returncode == code, f"helm {' '.join(words)}\n{done.stdout}{done.stderr}"
        return done.stderr if code else done.stdout

    def text(self, *words: str, chart: Path = CHART, code: int = 0) -> str:
        """Return a chart's text for the release ``slamhive`` in the namespace ``lab``, or the error."""
        return self._template((*words,), chart, code)

    def objects(self, *words: str, chart: Path = CHART) -> list[dict[str, Any]]:
        """Return the rendered objects."""
        return objects_of(self.text(*words, chart=chart))

    def _run_template(self, words: tuple[str, ...], chart: Path, code: int) -> str:
        return self.run(
            "template", "slamhive", str(chart), "-n", "lab", "--kube-version", VERSION, *words, code=code
        )


@pytest.fixture(scope="session")
def helm() -> Helm:
    program = _helm()
    if program is None:
        pytest.skip(
            "no helm: put it on the PATH, name it in $HELM, or run `make cluster-up`, which builds it"
        )
    return Helm(program)


@pytest.fixture(scope="session")
def read() -> Callable[[Path], dict[str, Any]]:
    """Read a file of one object."""
    return lambda path: objects_of(path.read_text(encoding="utf-8"))[0]


@pytest.fixture(params=sorted(path.stem for path in VALUES.glob("*.yaml")))
def variety(request: pytest.FixtureRequest) -> str:
    """Each of the files of values, by name."""
    return str(request.param)


@pytest.fixture
def rendered(helm: Helm, variety: str) -> list[dict[str, Any]]:
    """Objects that the chart renders with each of the files of values."""
    return helm.objects("-f", str(VALUES / f"{variety}.yaml"))


@pytest.fixture
def kept() -> Callable[[Path, str], None]:
    """Compare a file with what it should hold, or write it if asked."""

    def compare(path: Path, text: str) -> None:
        if os.environ.get("SLAMHIVE_UPDATE"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        found = path.read_text(encoding="utf-8") if path.exists() else ""
        assert found == text, (
            f"{path.relative_to(ROOT)} is out of date; if meant: SLAMHIVE_UPDATE=1 pytest tests/helm"
        )

    return compare
