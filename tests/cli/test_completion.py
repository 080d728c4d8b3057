# SPDX-License-Identifier: Apache-2.0
"""Completion by the shell: commands, their own commands, options and choices."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROGRAM = f"""\
#!{sys.executable}
import sys
sys.path[:0] = {[str(ROOT / "operator"), str(ROOT / "evaluator")]}
from slamhive.cli.main import main
main()
"""


@pytest.fixture
def command(tmp_path: Path) -> Path:
    """A folder with the command."""
    program = tmp_path / "slamhive"
    program.write_text(PROGRAM)
    program.chmod(0o755)
    return tmp_path


def said(folder: Path, *words: str, **variables: str) -> str:
    env = os.environ | {"PATH": f"{folder}:{os.environ['PATH']}", "HOME": str(folder)} | variables
    return subprocess.run(words, check=True, capture_output=True, text=True, env=env).stdout


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_shell_is_given_commands_and_their_own_commands(command: Path, shell: str) -> None:
    script = said(command, "slamhive", _SLAMHIVE_COMPLETE=f"source_{shell}")
    assert f"_SLAMHIVE_COMPLETE=complete_{shell}" in script
    for line, expected in (("slamhive ", {"run", "results"}), ("slamhive results ", {"table", "export"})):
        asked = {
            "bash": {"COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))},
            "zsh": {"_TYPER_COMPLETE_ARGS": line},
            "fish": {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
        }[shell]
        found = said(command, "slamhive", _SLAMHIVE_COMPLETE=f"complete_{shell}", **asked)
        assert expected <= set(re.findall(r"^\W*([\w-]+)", found, re.MULTILINE))


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_what_is_typed(command: Path) -> None:
    script = """
        eval "$(env _SLAMHIVE_COMPLETE=source_bash slamhive)"
        COMP_WORDS=(slamhive results export --to re) COMP_CWORD=4
        _slamhive_completion slamhive
        echo "${COMPREPLY[@]}"
    """
    assert said(command, "bash", "-c", script).split() == ["rerun"]
