# SPDX-License-Identifier: Apache-2.0
"""The pages' JavaScript without a browser: Node.js runs the tests of this folder."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
OLDEST = (22, 15)
"""Version of Node.js from which on modules can be found elsewhere."""


@pytest.fixture(scope="module")
def node() -> str:
    """Node.js of the environment, or the machine's."""
    found = "none"
    for name in (str(Path(sys.executable).parent / "node"), "node"):
        if program := shutil.which(name):
            found = subprocess.run([program, "--version"], capture_output=True, text=True, check=True).stdout
            if tuple(map(int, re.findall(r"\d+", found)[:2])) >= OLDEST:
                return program
    return pytest.skip(f"needs Node.js 22.15 or newer, here is {found.strip()}: make install brings it")


def test_the_tests_of_node_pass(node: str) -> None:
    command = [node, "--import", "./vendored.js", "--test", "--test-reporter=spec"]
    result = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
    told = result.stdout.rpartition("failing tests:")[2] or result.stdout
    assert result.returncode == 0, f"{told}\n{result.stderr}"
    passed = re.search(r"^ℹ pass (\d+)$", result.stdout, re.MULTILINE)
    assert passed is not None, result.stdout
    assert int(passed[1]) > 200, "some files with tests were not found"


def test_packages_come_from_the_public_registry() -> None:
    packages = json.loads((HERE / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    for name, entry in packages.items():
        if name:
            assert entry["resolved"].startswith("https://registry.npmjs.org/"), name
            assert entry["integrity"].startswith("sha512-"), name
