# SPDX-License-Identifier: Apache-2.0
"""Signs of life of an installation: few lines in a log, one line that changes on a terminal."""

from __future__ import annotations

import io
import os
import sys
from typing import TYPE_CHECKING

import pytest
import telling

from slamhive.local.programs.installing import Steps

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


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
    teller = telling.Teller(to, lambda: now)
    steps = Steps(requirements)
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


UV_SAYS = """\
Using Python 3.11.7 environment at: .venv.making
Resolved 50 packages in 1.59s
Downloading numpy (16.1MiB)
Downloading opencv-python-headless (58.4MiB)
 Downloaded numpy
 Downloaded opencv-python-headless
Prepared 49 packages in 4.16s
Installed 49 packages in 276ms
 + annotated-doc==0.0.7
"""


def test_uv_is_followed_as_pip_is(requirements: Path) -> None:
    steps = Steps(requirements)
    assert [step for line in UV_SAYS.splitlines() if (step := steps.step(line))] == [
        ("fetching packages", 0, 50),
        ("downloading numpy (16.1MiB)", 0, 50),
        ("downloading opencv-python-headless (58.4MiB)", 0, 50),
        ("fetched numpy", 1, 50),
        ("fetched opencv-python-headless", 2, 50),
        ("installing 49 packages", 50, 50),
    ]


@pytest.mark.parametrize(("code", "told"), [(0, []), (3, ["ERROR: no"])])
def test_what_it_says_beside_its_steps_is_the_reason_why_it_failed(
    requirements: Path, code: int, told: list[str]
) -> None:
    pip = (
        "import sys; print('Collecting x-0', flush=True); print('ERROR: no', file=sys.stderr);"
        "sys.exit(int(sys.argv[1]))"
    )
    to, nothing = io.StringIO(), os.open(os.devnull, os.O_RDONLY)
    command = [sys.executable, "-c", pip, str(code)]
    steps, teller = Steps(requirements), telling.Teller(to, lambda: 0.0)
    assert telling.install(command, steps, teller, os.environ, nothing) == told
    os.close(nothing)
    assert to.getvalue() == "0 of 150 packages, 0 s: collecting x-0\n"
