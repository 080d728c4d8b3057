# SPDX-License-Identifier: Apache-2.0
"""The entry point of the command ``slamhive``."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from slamhive import __version__
from slamhive.cli import (
    algorithms,
    cluster,
    dashboard,
    datasets,
    importing,
    report,
    results,
    running,
    vocabulary,
)
from slamhive.cli.console import FAILED, INTERRUPTED, WRONG_INPUT, complain
from slamhive.model.errors import InputError, SlamHiveError

app = typer.Typer(
    name="slamhive",
    help="Compare SLAM algorithms: accuracy, CPU and memory over datasets, parameters and rates.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command()(running.demo)
app.command()(running.run)
app.command()(running.plan)
app.command()(running.validate)
app.command()(dashboard.dashboard)
app.command()(report.report)
app.command()(report.paper_table)
for command in (cluster.submit, cluster.status, cluster.logs, cluster.cancel, cluster.fetch):
    app.command()(command)
algorithms.app.command("train-vocabulary")(vocabulary.train)
app.add_typer(results.app, name="results")
app.add_typer(datasets.app, name="dataset")
app.add_typer(algorithms.app, name="algorithm")
app.add_typer(importing.app, name="import")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"slamhive {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command; what goes wrong ends in a sentence and an exit code."""
    try:
        app()
    except InputError as error:
        complain(str(error))
        sys.exit(WRONG_INPUT)
    except SlamHiveError as error:
        complain(str(error))
        sys.exit(FAILED)
    except KeyboardInterrupt:
        complain("interrupted")
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except OSError as error:
        complain(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        sys.exit(FAILED)
