# SPDX-License-Identifier: Apache-2.0
"""Signs of life of `make install`: few lines in a log, one line that changes on a terminal."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from slamhive.local.programs import installing

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[3]
PROGRAM = ROOT / "operator/slamhive/local/programs/installing.py"


class Terminal(io.StringIO):
    """A terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def requirements(tmp_path: Path) -> Path:
    """A file of 150 packages."""
    path = tmp_path / "constraints.txt"
    path.write_text("".join(f"package-{k}==1.{k} \\\n    --hash=sha256:0\n" for k in range(150)))
    return path


def said(requirements: Path, to: io.StringIO, moments: Callable[[int], float]) -> str:
    """Return the words about 150 packages and a long installation, line by line of pip."""
    now = 0.0
    teller = installing.Teller(to, lambda: now)
    steps = installing.PipSteps(requirements)
    for k in range(150):
        now = moments(k)
        for line in (
            f"Collecting package-{k}==1.{k}",
            f"  Downloading package_{k}-1.{k}-py3-none-any.whl (2 kB)",
        ):
            step = steps.step(line)
            assert step is not None
            teller.take(step)
            teller.beat()
    step = steps.step("Installing collected packages: a, b, c")
    assert step is not None
    teller.take(step)
    for _ in range(300):
        now += 1
        teller.beat()
    teller.end()
    return to.getvalue()


def test_a_log_gets_a_line_now_and_then(requirements: Path) -> None:
    lines = said(requirements, io.StringIO(), lambda k: 0.5 * k).splitlines()
    assert lines[0] == "0 of 150 packages, 0 s: collecting package-0"
    assert len(lines) <= 20
    assert any(line.startswith("75 of 150 packages, 38 s: ") for line in lines)
    assert lines[-1].endswith("installing 3 packages")


def test_slow_packages_bring_no_more_lines_than_that(requirements: Path) -> None:
    assert len(said(requirements, io.StringIO(), lambda k: 20.0 * k).splitlines()) <= 24


def test_a_terminal_has_one_line_that_goes_in_the_end(requirements: Path) -> None:
    text = said(requirements, Terminal(), lambda k: 0.5 * k)
    assert "\n" not in text
    assert "\r\x1b[K75 of 150 packages, 38 s: downloading package_75 (2 kB)" in text
    assert text.endswith("\r\x1b[K")


@pytest.mark.parametrize("code", [0, 3])
def test_it_runs_before_anything_is_installed_and_ends_as_pip_does(requirements: Path, code: int) -> None:
    pip = (
        "import sys; print('Collecting x-0'); print('ERROR: no', file=sys.stderr); sys.exit(int(sys.argv[1]))"
    )
    # -S: without any package but Python's own, as make install has it.
    command = [sys.executable, "-S", "-P", PROGRAM, requirements, sys.executable, "-c", pip, str(code)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert done.stdout == "0 of 150 packages, 0 s: collecting x-0\n"
    assert done.stderr == "ERROR: no\n"


def test_make_install_runs_it() -> None:
    command = ["make", "--dry-run", "--always-make", "VENV=elsewhere", "install"]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert str(PROGRAM.relative_to(ROOT)) in told
    assert "nothing is printed" not in told
