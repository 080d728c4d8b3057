# SPDX-License-Identifier: Apache-2.0
"""A study of the actor that was run once, its bundle, and bundles of which something is changed."""

from __future__ import annotations

import hashlib
import json
import zipfile
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

from furnishing import furnish
from slamhive.bridges.bundles import contents
from slamhive.cli import running
from slamhive.cli.sharing import bundles

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SWEEP = """\
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: acts}
spec:
  template: {spec: {algorithmRef: {name: actor}, datasetRef: {name: tiny}}}
  matrix: [{path: parameters.act, values: [good, crash]}]
  repetitions: 2
"""


@pytest.fixture(scope="session")
def studied(share: Callable[..., Path], environments: Path, tiny: Path) -> Path:
    """A home in which the study ran; tests share it, and read it alone."""

    def fill(folder: Path) -> None:
        home = furnish(folder / "home", environments, tiny)
        (home / "acts.yaml").write_text(SWEEP)
        variables = {"SLAMHIVE_HOME": str(home), "SLAMHIVE_ARCHIVE": ""}
        # Two of its runs crash, as they are to.
        app = _alone(running.run)
        outcome = CliRunner().invoke(app, [str(home / "acts.yaml"), "-j", "1"], env=variables)
        assert outcome.exit_code == 1, outcome.output
        words = ["acts", "-o", str(folder / "study.zip"), "--license", "CC-BY-4.0", "--author", "A. Author"]
        outcome = CliRunner().invoke(_alone(bundles.make_bundle), words, env=variables)
        assert outcome.exit_code == 0, outcome.output

    return share("studied", fill) / "home"


def _alone(command: Callable[..., Any]) -> Any:
    import typer

    app = typer.Typer()
    app.command()(command)
    return app


@pytest.fixture
def study(studied: Path) -> Path:
    """The bundle of the study."""
    return studied.parent / "study.zip"


@pytest.fixture
def elsewhere(tmp_path: Path, tiny: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home that knows the dataset and no algorithm of the study; commands work in it."""
    home = tmp_path / "elsewhere"
    home.mkdir()
    (home / "datasets").symlink_to(tiny)
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    return home


@pytest.fixture
def rezip(study: Path, tmp_path: Path) -> Callable[..., Path]:
    """Writes the bundle anew with some files changed, by their names; None leaves one out."""

    def write(changes: dict[str, bytes | None], *, forged: bool = False) -> Path:
        with zipfile.ZipFile(study) as archive:
            files: dict[str, bytes | None] = {name: archive.read(name) for name in archive.namelist()}
        files |= changes
        if forged:  # as if it had been so when the bundle was made
            told = json.loads(files["study.json"] or b"")
            changed = changes.keys() - {"study.json"}
            told["files"] |= {name: hashlib.sha256(files[name] or b"").hexdigest() for name in changed}
            words, line, _ = (files["README.md"] or b"").partition(contents.STATED.encode())
            readme = words + (line + contents.study_sha256(told).encode() if line else b"")
            files["README.md"] = readme
            told["files"]["README.md"] = hashlib.sha256(readme).hexdigest()
            files["study.json"] = json.dumps(told).encode()
        path = tmp_path / "changed.zip"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in files.items():
                if content is not None:
                    archive.writestr(name, content)
        return path

    return write


def names_in(study: Path, ending: str) -> list[str]:
    """Return the names of files in a bundle."""
    with zipfile.ZipFile(study) as archive:
        return sorted(name for name in archive.namelist() if name.endswith(ending))


@pytest.fixture
def trajectories(study: Path) -> list[str]:
    """Names of the trajectories in the bundle."""
    return names_in(study, "/trajectory.txt")
