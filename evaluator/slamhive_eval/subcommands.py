# SPDX-License-Identifier: Apache-2.0
"""Table of the commands of ``slamhive-eval``; loads and runs the one that was called.

argparse, not typer, and only the module of the command asked for: starting is what most of a small
evaluation takes.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import sys
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from collections.abc import Sequence

COMMANDS: dict[str, tuple[str, str]] = {
    "ape": ("slamhive_eval.commands.ape", "absolute pose error"),
    "rpe": ("slamhive_eval.commands.rpe", "relative pose error"),
    "kitti": ("slamhive_eval.commands.kitti", "errors over KITTI's segments"),
    "drift": ("slamhive_eval.commands.drift", "errors over sub-trajectories, scale drift, gaps"),
    "consistency": ("slamhive_eval.commands.consistency", "covariances against errors: NEES, sigma bounds"),
    "health": ("slamhive_eval.commands.health", "a system's own confidence against its losses"),
    "segments": ("slamhive_eval.commands.segments", "an estimate that started again, piece by piece"),
    "repeated": ("slamhive_eval.commands.repeated", "several runs of one configuration together"),
    "report": ("slamhive_eval.commands.report", "a page or figure that shows estimates"),
    "map": ("slamhive_eval.commands.map", "a map against a reference, or its sharpness"),
    "explain": ("slamhive_eval.commands.explain", "why a pair doesn't fit: clock, frames, conventions"),
    "batch": ("slamhive_eval.commands.batch", "many estimates, one JSON object a line"),
    "traj": ("slamhive_eval.commands.traj", "what trajectories are like; convert, move, match, cut them"),
    "relations": ("slamhive_eval.commands.relations", "errors over pairwise relations"),
    "score": ("slamhive_eval.commands.score", "score of a public challenge"),
}
"""Module and one line of help by name, in the order of ``--help``; see `slamhive_eval.commands`."""


def run(arguments: Sequence[str] | None) -> int:
    """Parse the words of a command and do it.

    Args:
        arguments: Words after the program's name; None for those of the process.

    Returns:
        The exit code.

    Raises:
        EvaluationError: Wrong input.
        SystemExit: 0 after ``--help``, 2 for words that don't fit.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    asked = parser(words[0] if words else None).parse_args(words)
    if not gc.isenabled():  # what was imported stays; garbage comes from here on
        gc.freeze()
        gc.enable()
    code: int = asked.run(asked)
    return code


class _CommandParser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def parser(command: str | None) -> argparse.ArgumentParser:
    """The parser that knows all commands by name and the arguments of one of them."""
    program = _CommandParser(
        prog="slamhive-eval",
        description="Measure estimated trajectories against ground truth.",
        epilog="Example: slamhive-eval ape groundtruth.txt trajectory.txt --align se3",
    )
    commands = program.add_subparsers(required=True, metavar="COMMAND", parser_class=_CommandParser)
    for name, (module, line) in COMMANDS.items():
        added = commands.add_parser(name, help=line)
        if name == command:
            found = importlib.import_module(module)
            found.add(added)
            added.set_defaults(run=found.run)
    return program
