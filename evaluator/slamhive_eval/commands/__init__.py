# SPDX-License-Identifier: Apache-2.0
"""The commands of ``slamhive-eval``, one module each; `slamhive_eval.subcommands.COMMANDS` names them.

A module has two functions::

    def add(parser: argparse.ArgumentParser) -> None    # its description, epilog and arguments
    def run(asked: argparse.Namespace) -> int           # does it, writes to stdout, returns the exit code

Only the module of the command that was asked for is imported. ``run`` raises EvaluationError for wrong input;
the sentence goes to stderr and the exit code is 2. `output.emit` prints a result as JSON or as a table.

What ``ape`` and ``rpe`` measured can leave in other forms too: `output.WRITERS` names modules with the
functions ``add(parser)`` and ``write(asked, measured)``, the latter given a list of `output.Measured`.
They are imported for the options they add, hence import what they need only in ``write``.
"""
