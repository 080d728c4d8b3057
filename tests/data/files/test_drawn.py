# SPDX-License-Identifier: Apache-2.0
"""Servers that lie and archives of strangers, drawn: the same ones each time; ``make fuzz`` draws others."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(("script", "cases"), [("servers", 40), ("archives", 20)])
def test_whatever_comes_is_right_or_refused_by_one_sentence(script: str, cases: int) -> None:
    path = Path(__file__).parents[2] / "fuzz" / f"{script}.py"
    words = [sys.executable, path, "--start", "1", "--cases", str(cases)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode or done.stderr:
        pytest.fail(done.stdout + done.stderr, pytrace=False)
    assert done.stdout.splitlines()[1].startswith(f"{cases} cases: ")
