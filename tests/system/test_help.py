# SPDX-License-Identifier: Apache-2.0
"""Every command explains itself, with an example that names it."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest
import typer.main
from typer.testing import CliRunner

from slamhive.cli.main import COMMANDS as FIRST_WORDS
from slamhive.cli.main import app, load

if TYPE_CHECKING:
    from collections.abc import Iterator


def commands(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], bool]]:
    """Return all commands by their words, and whether each is a group of others."""
    children = getattr(command, "commands", {})
    yield path, bool(children)
    for name, child in children.items():
        yield from commands(child if path else load(name), (*path, name))


COMMANDS = list(commands(typer.main.get_command(app)))


@pytest.mark.parametrize(
    ("path", "group"), COMMANDS, ids=lambda value: " ".join(value) if isinstance(value, tuple) else ""
)
def test_help_comes_with_an_example(path: tuple[str, ...], group: bool) -> None:
    result = CliRunner().invoke(app, [*path, "--help"])
    assert result.exit_code == 0
    text = " ".join(result.output.split())
    assert "Usage:" in text
    assert group or f"Example: slamhive {' '.join(path)}" in text


def test_the_commands_are_those_promised() -> None:
    names = {" ".join(path) for path, _ in COMMANDS}
    promised = {
        *("demo", "run", "plan", "validate", "import slam-hive", "dashboard", "report", "paper-table"),
        *("submit", "status", "logs", "cancel", "fetch"),
        *(f"results {name}" for name in ("list", "show", "table", "export")),
        *(f"dataset {name}" for name in ("list", "show", "add", "make", "prepare", "export", "check")),
        *("results prune", "gc", "home", "dataset remove", "dataset rename", "algorithm remove"),
        *(f"search {name}" for name in ("show", "best")),
        *(f"sweep {name}" for name in ("list", "rename", "remove")),
        *(f"algorithm {name}" for name in ("list", "show", "check")),
    }
    assert promised <= names


def test_the_version_is_printed(system: Any) -> None:
    code, out, err = system("--version")
    assert (code, err) == (0, "")
    assert out.startswith("slamhive 0.")
    code, out, err = system("--help")
    assert (code, err) == (0, "")
    assert "results" in out


@pytest.mark.parametrize("name", FIRST_WORDS)
def test_a_command_is_listed_with_the_first_line_of_its_own_help(name: str) -> None:
    assert FIRST_WORDS[name].summary == load(name).help.splitlines()[0]


@pytest.mark.parametrize(
    ("words", "unwanted"),
    [
        ("--help", "numpy pydantic rich sqlalchemy"),
        ("--version", "numpy pydantic rich sqlalchemy"),
        ("results list", "cv2 rosbags kubernetes yaml jinja2"),
        ("dataset list", "cv2 rosbags kubernetes sqlalchemy"),
        ("algorithm list", "cv2 rosbags kubernetes sqlalchemy"),
    ],
)
def test_a_command_imports_only_what_it_needs(words: str, unwanted: str, tmp_path: Any) -> None:
    """Start-up is most of the time that a short command takes."""
    program = (
        "import sys; from slamhive.cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *words.split()],
        env={"SLAMHIVE_HOME": str(tmp_path), "PATH": ""},
        capture_output=True,
        text=True,
        check=True,
    )
    assert not set(unwanted.split()) & set(done.stderr.split())


def test_models_are_made_when_they_are_first_used() -> None:
    """Validators that a default needs would be made at each start of each command."""
    program = (
        "from slamhive.model.dataset import Dataset; from slamhive.model.synthetic import SyntheticLidar\n"
        "assert Dataset and not SyntheticLidar.__pydantic_complete__\n"
        "assert SyntheticLidar.model_validate({}).rings == 32 and SyntheticLidar.__pydantic_complete__"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
