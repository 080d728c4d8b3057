# SPDX-License-Identifier: Apache-2.0
"""SLAM Hive: compare SLAM algorithms on a workstation or on Kubernetes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    __version__: str


def __getattr__(name: str) -> Any:
    # When asked for: the player's image has this package without the evaluator.
    if name == "__version__":
        from slamhive_eval import __version__  # noqa: PLC0415

        return __version__
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def results(
    home_or_url: str | os.PathLike[str] | None = None,
    *,
    where: str | None = None,
    columns: str | Sequence[str] | None = None,
    sweep: str | Sequence[str] | None = None,
    evaluation: str | None = None,
    superseded: bool = False,
    reused: bool = False,
    also: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None = None,
    frame: str = "pandas",
) -> Any:
    """Return finished runs as a data frame, one row a run and evaluation.

    They are those that ``slamhive results table`` averages: results of earlier versions of an algorithm,
    dataset or sweep are left out, and equal content is there once, however many sweeps refer to it.

    The columns are those of ``slamhive results``: ``ate.rmse`` (m), ``usage.cpu.meanCores``,
    ``usage.memory.peakBytes``, ``parameters.NAME``, ``input.frameRate``, ``outcome`` and so on, in stored
    units, and beside them ``id``, ``status`` (what became of the run in one word), ``disturbed`` and
    ``ate.extended``. Failed runs are there too, without figures: look at ``status`` before you average.

    ::

        import slamhive

        runs = slamhive.results(where="dataset == 'mh01' and outcome == 'Tracked'")
        runs.groupby("parameters.nFeatures")["ate.rmse"].describe()
        runs[runs["ate.rmse"] < 1].figure("lines", x="nFeatures", y="ate.rmse:cm")

    ``figure`` is ``slamhive figure`` for the rows that are left (matplotlib, the extra ``plot``).

    Args:
        home_or_url: a home, an SQLite file, or a database URL (``postgresql://user@host/slam``); by default
            the home that ``$SLAMHIVE_HOME`` names.
        where: only rows that meet a condition, as ``slamhive results --where`` takes it.
        columns: names, as a list or joined by commas; by default all of them.
        sweep: only runs of this sweep, or of these.
        evaluation: only this evaluation; failed runs that it was meant to measure are there without figures.
        superseded: whether results of earlier versions are there too; column ``superseded`` says which.
        reused: whether runs that took over an equal one's result are there too.
        also: another home, an archive's file or a database URL, or several, read beside it, as ``--also``
            takes them: ``anna=/data/anna/slamhive``. Column ``home`` says whose a row is. By default
            those that ``$SLAMHIVE_ALSO`` names, if ``home_or_url`` isn't given.
        frame: ``pandas`` or ``polars``; each is an extra of slamhive.

    Returns:
        A ``pandas.DataFrame`` or ``polars.DataFrame``. Whole numbers and truth values that some rows lack
        are of the nullable kinds; times are in UTC; in polars what is neither number nor text is JSON.

    Raises:
        slamhive.model.errors.InputError: there is no archive, a name is unknown, the condition can't be
            understood, or the library isn't installed.
    """
    # Imported when called, and by name: everything in here imports this package for its version.
    import importlib  # noqa: PLC0415

    made = importlib.import_module("slamhive.reporting.dataframes")
    found = made.results(
        home_or_url,
        where=where,
        columns=columns,
        sweep=sweep,
        evaluation=evaluation,
        superseded=superseded,
        reused=reused,
        also=also,
        frame=frame,
    )
    if frame == "pandas":
        importlib.import_module("slamhive.figures.notebooks")  # found.figure(…)
    return found
