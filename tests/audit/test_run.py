# SPDX-License-Identifier: Apache-2.0
"""make audit: it passes only where every package was checked. The two services are played."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parent / "run.py"
LOCKED = json.loads((SCRIPT.parents[1] / "javascript" / "package-lock.json").read_text())["packages"]
VENDORED = 4
TOTAL = VENDORED + len(LOCKED) - 1  # the first is the folder itself
NPM: dict[str, Any] = {"vulnerabilities": {}, "metadata": {"dependencies": {"total": TOTAL}}}
ADVISORY = {"title": "Bad drawing", "url": "https://example.test/1"}


def program(folder: Path, name: str, code: str) -> None:
    path = folder / name
    path.write_text(f"#!{sys.executable}\nimport json, re, sys\nfrom pathlib import Path\n{code}\n")
    path.chmod(0o755)


ALL_CLEAN = """
text = Path(sys.argv[sys.argv.index("--requirement") + 1]).read_text()
found = [{"name": n, "version": v, "vulns": []} for n, v in re.findall(r"(\\S+)==(\\S+)", text)]
"""
TELL = "print(json.dumps({'dependencies': found}))"


@pytest.fixture
def audit(tmp_path: Path) -> Any:
    """Runs the command with a played pip-audit and npm."""

    def run(python: str = ALL_CLEAN + TELL, npm: object = NPM) -> tuple[int, str, str]:
        program(tmp_path, "pip-audit", python)
        if npm is not None:
            program(tmp_path, "npm", f"print({json.dumps(npm)!r})")
        environment = os.environ | {"PATH": str(tmp_path)}
        command = [sys.executable, str(SCRIPT)]
        result = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert "Traceback" not in result.stderr
        return result.returncode, result.stdout, result.stderr

    return run


def test_all_checked_and_nothing_known(audit: Any) -> None:
    code, out, err = audit()
    assert (code, err) == (0, "")
    assert "nothing is known of" in out


def test_advisories_are_told(audit: Any) -> None:
    python = ALL_CLEAN + "found[0]['vulns'] = [{'id': 'CVE-1', 'fix_versions': ['9']}]\n" + TELL
    code, out, _ = audit(python, NPM | {"vulnerabilities": {"echarts": {"via": [ADVISORY]}}})
    assert code == 1
    assert "CVE-1, mended in 9" in out
    assert "Bad drawing, https://example.test/1" in out


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"python": ALL_CLEAN + "found.pop()\n" + TELL}, "no answer"),
        (
            {
                "python": ALL_CLEAN
                + "found[0] = {'name': found[0]['name'], 'skip_reason': 'not found'}\n"
                + TELL
            },
            "not found",
        ),
        ({"python": ALL_CLEAN + "found[0]['version'] = '0'\n" + TELL}, "no answer"),
        ({"python": "sys.exit('no route to host')"}, "pip-audit failed: no route to host"),
        ({"npm": {"message": "405 Method Not Allowed"}}, "npm audit says 405 Method Not Allowed"),
        ({"npm": NPM | {"metadata": {"dependencies": {"total": 0}}}}, f"npm audit checked 0 of {TOTAL}"),
        ({"npm": None}, "npm is not installed"),
    ],
)
def test_what_was_not_checked_is_an_error(audit: Any, changes: dict[str, Any], sentence: str) -> None:
    code, out, err = audit(**changes)
    assert code == 2
    assert "nothing is known" not in out
    assert sentence in err
