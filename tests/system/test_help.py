# SPDX-License-Identifier: Apache-2.0
"""Every command explains itself, with an example that names it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
import typer.main
from typer.testing import CliRunner

from slamhive.cli.main import app

if TYPE_CHECKING:
    from collections.abc import Iterator


def commands(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], bool]]:
    """Return all commands by their words, and whether each is a group of others."""
    children = getattr(command, "commands", {})
    yield path, bool(children)
    for name, child in children.items():
        yield from commands(child, (*path, name))


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
        *(f"dataset {name}" for name in ("list", "show", "add", "make", "prepare", "check")),
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
