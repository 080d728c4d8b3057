# SPDX-License-Identifier: Apache-2.0
"""The entry point of the command ``slamhive``."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import warnings
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from typer.core import TyperGroup

from slamhive import __version__
from slamhive.cli.parts.exits import FAILED, INTERRUPTED, WRONG_INPUT
from slamhive.model.errors import InputError, SlamHiveError, sentence
from slamhive.model.leftout import LeftOutWarning
from slamhive.tables.uncollected import uncollected

if TYPE_CHECKING:
    from collections.abc import Iterator


class _Command(NamedTuple):
    """A command by the module of this package that has it, and the first line of its help."""

    module: str
    attribute: str
    summary: str


# Importing all commands takes two seconds and 100 MB. ``slamhive --help`` and completion get along with this
# table; the module is imported when its command is called. A test holds the lines against the commands' own.
COMMANDS = {
    "demo": _Command(
        "running",
        "demo",
        "Compare real algorithms on a generated recording: a table, what won, at what cost, what next.",
    ),
    "run": _Command(
        "running", "run", "Run sweeps on this machine, or on a cluster as if it were this machine."
    ),
    "gate": _Command(
        "gating.command",
        "gate",
        "Tell whether an algorithm has become worse than what was recorded, by as few runs as make it sure.",
    ),
    "plan": _Command(
        "plans", "plan", "Show the runs that sweeps expand to, without running them, or what they will cost."
    ),
    "validate": _Command(
        "plans", "validate", "Check manifests: everything that run would refuse, and what is missing here."
    ),
    "schema": _Command(
        "schemas",
        "schema",
        "Print the JSON Schema of a kind, by which an editor completes and checks manifests.",
    ),
    "new": _Command("new", "app", "Write a new sweep, dataset or algorithm by answering questions."),
    "dashboard": _Command(
        "dashboard",
        "dashboard",
        "Show the archive in a web browser: leaderboard, charts, runs. It changes nothing; Ctrl-C ends it.",
    ),
    "site": _Command(
        "dashboard",
        "site",
        "Write the dashboard as a site of static files: leaderboard, charts, studies, the page of each run.",
    ),
    "published": _Command("published", "app", "Numbers of papers and leaderboards, shown beside own runs."),
    "report": _Command(
        "report",
        "report",
        "Write one self-contained HTML page: leaderboard, comparison, charts, all runs; or one run to share.",
    ),
    "paper-table": _Command(
        "report",
        "paper_table",
        "Write a table for a paper: LaTeX, Markdown or CSV, best in bold, failures shown.",
    ),
    "figure": _Command(
        "figure",
        "figure",
        "Draw a figure for a paper, as PDF, SVG or PNG, with its numbers as CSV beside it.",
    ),
    "submission": _Command(
        "submission",
        "submission",
        "Write the ZIP archive for a challenge: one run for each sequence, checked, in the right format.",
    ),
    "bundle": _Command(
        "sharing.bundles",
        "make_bundle",
        "Write a study as one file: manifests, results, trajectories, environments; not the recordings.",
    ),
    "verify": _Command(
        "sharing.bundles",
        "verify_bundle",
        "Compute every figure of a bundle again from its trajectories: what agrees to the last digit?",
    ),
    "submit": _Command(
        "cluster.commands", "submit", "Send sweeps, runs and what they need to a cluster, which runs them."
    ),
    "status": _Command(
        "cluster.commands",
        "status",
        "Show progress and problems of sweeps, runs and evaluations on a cluster.",
    ),
    "logs": _Command(
        "cluster.commands", "logs", "Print the log of a run on a cluster; if its pod is gone, the last lines."
    ),
    "cancel": _Command(
        "cluster.commands",
        "cancel",
        "End runs on a cluster. A sweep is suspended and its runs in flight are cancelled.",
    ),
    "fetch": _Command(
        "cluster.commands",
        "fetch",
        "Copy finished runs of a cluster into the archive here, for slamhive results.",
    ),
    "view": _Command(
        "view", "view", "Show a run in Rerun's viewer: truth, estimate, error, images and usage over time."
    ),
    "results": _Command("results", "app", "Finished runs: lists, tables, files."),
    "sweep": _Command("sweeps", "app", "Sweeps in the archive: list, rename and remove them."),
    "search": _Command("searches", "app", "Searches in the archive: what they tried, and the best setting."),
    "dataset": _Command("datasets", "app", "Datasets: list, add, check, prepare and export them."),
    "algorithm": _Command("algorithms", "app", "Algorithms: list, add and check them."),
    "home": _Command(
        "home",
        "home",
        "Say where everything is kept: $SLAMHIVE_HOME. With --size: what takes space, and how to free it.",
    ),
    "gc": _Command(
        "home",
        "gc",
        "Remove what nothing refers to: variants, environments, assets, and leftovers of killed commands.",
    ),
    "import": _Command("importing", "app", "Bring runs of other people and other systems into the archive."),
    "doctor": _Command(
        "doctor",
        "doctor",
        "Check this machine: what is missing, what does not work without it, and how to get it.",
    ),
    "archive": _Command(
        "archive",
        "app",
        "Look after the archive: $SLAMHIVE_HOME/archive.sqlite, or the database in $SLAMHIVE_ARCHIVE.",
    ),
}


class _CommandInterrupted(BaseException):
    """A KeyboardInterrupt that Typer doesn't see: it would end the command without a word."""


@contextmanager
def _interruption() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        raise _CommandInterrupted from None


class _Commands(TyperGroup):
    """A group whose commands are imported when they are called."""

    def make_context(self, *words: Any, **options: Any) -> Any:
        """Read the words of the command line."""
        with _interruption():
            return super().make_context(*words, **options)

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        """Call the command that was asked for."""
        with _interruption():
            return super().invoke(ctx)

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> tuple[str | None, Any, list[str]]:  # type: ignore[override]
        """Return the command that the first word names, its name, and the words that are left."""
        name, named, rest = super().resolve_command(ctx, args)
        return name, load(name) if name in COMMANDS else named, rest


def _group(cls: type[TyperGroup], **settings: Any) -> typer.Typer:
    group = typer.Typer(cls=cls, pretty_exceptions_enable=False, rich_markup_mode=None, **settings)
    group.callback()(_options)
    return group


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"slamhive {__version__}")
        raise typer.Exit


def _options(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def _summary_alone() -> None:
    """Stand for a command that is not imported yet."""


@cache
def load(name: str) -> Any:
    """Return a command ready to be called; its module is imported."""
    command = COMMANDS[name]
    with uncollected():
        made = getattr(import_module(f"slamhive.cli.{command.module}"), command.attribute)
    alone = _group(TyperGroup)
    if isinstance(made, typer.Typer):
        alone.add_typer(made, name=name)
    else:
        alone.command(name)(made)
    return typer.main.get_command(alone).commands[name]  # type: ignore[attr-defined]


app = _group(
    _Commands,
    name="slamhive",
    help="Compare SLAM algorithms: accuracy, CPU and memory over datasets, parameters and rates.",
    no_args_is_help=True,
)
for _name, _command in COMMANDS.items():
    app.command(_name, help=_command.summary)(_summary_alone)


def main() -> None:
    """Run the command; what goes wrong ends in a sentence and an exit code."""
    # Python looks through everything that is left before it ends, for a sixth of a figure's time.
    atexit.register(gc.freeze)
    # Our matrices are small: more threads would wait for each other, at work. Programs have their own number.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _say_warnings()
    try:
        app()
    except InputError as error:
        _end(f"--{error}" if error.argument else str(error), WRONG_INPUT)
    except SlamHiveError as error:
        _end(str(error), FAILED)
    except (KeyboardInterrupt, _CommandInterrupted):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is ending; another one must not break into that
        _end("interrupted", INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except OSError as error:
        _end(sentence(error), FAILED)


def _say_warnings() -> None:
    """Have it said, once, what of an archive can't be read and is left out."""
    shown = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, LeftOutWarning):
            from slamhive.cli.parts.console import remark  # as in _end

            remark(str(message))
        else:
            shown(message, category, *where, **more)

    warnings.filterwarnings("default", category=LeftOutWarning)
    warnings.showwarning = show


def _end(message: str, code: int) -> None:
    from slamhive.cli.parts.console import complain  # Rich, which help and completion do without

    complain(message)
    sys.exit(code)
