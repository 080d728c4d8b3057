# SPDX-License-Identifier: Apache-2.0
"""Files that ``ape`` and ``rpe`` write: evo's result archives, error arrays, CSV and LaTeX tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive_eval.errors import FileError, OptionError
from slamhive_eval.statistics import IN_UNIT, STATISTICS

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from slamhive_eval.commands.output import Measured
    from slamhive_eval.formats.evo_zip import ErrorSeries

COLUMNS = ("estimate", "relation", *STATISTICS, "poses", "pairs", "delta", "unit", "alignment", "scale")


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    group = parser.add_argument_group("files to write")
    group.add_argument(
        "--save-results", metavar="ZIP", help="results for evo_res; of several estimates, into this folder"
    )
    group.add_argument(
        "--save-errors", metavar="NPZ", help="error arrays for numpy; of several estimates, into this folder"
    )
    group.add_argument("--csv", metavar="FILE", help="the statistics as comma-separated values")
    group.add_argument("--latex", metavar="FILE", help="the statistics as a LaTeX table")


def write(asked: argparse.Namespace, measured: Sequence[Measured]) -> None:
    """Write what was asked for."""
    if asked.save_results or asked.save_errors:
        from slamhive_eval.formats import evo_zip  # noqa: PLC0415 - only where asked for

        series = [_series(asked, one) for one in measured]
        _each(asked.save_results, series, ".zip", evo_zip.write_evo_zip)
        _each(asked.save_errors, series, ".npz", evo_zip.write_error_arrays)
    if asked.csv or asked.latex:
        from slamhive_eval.reports import result_tables  # noqa: PLC0415

        rows = [_row(one) for one in measured]
        if asked.csv:
            _write_text(asked.csv, result_tables.csv_table(rows, COLUMNS))
        if asked.latex:
            names = ("estimate", *IN_UNIT, "poses" if measured[0].metric == "ape" else "pairs")
            caption = _series(asked, measured[0]).title.replace("\n", " ")
            _write_text(
                asked.latex,
                result_tables.latex_table(rows, dict(zip(names, names, strict=True)), caption, best=IN_UNIT),
            )


def _series(asked: argparse.Namespace, one: Measured) -> ErrorSeries:
    import numpy as np  # noqa: PLC0415

    from slamhive_eval.formats.evo_zip import ErrorSeries  # noqa: PLC0415

    detail = ""
    if one.metric == "rpe":
        kind = "all" if asked.all_pairs else "consecutive"
        detail = f"for delta = {asked.delta:g} ({asked.unit}) using {kind} pairs"
    method = one.result["alignment"]["method"]
    return ErrorSeries(
        metric=one.metric,
        relation=asked.relation,
        errors=one.errors,
        reference=one.reference,
        estimate=one.estimate,
        pairs=one.pairs,
        method=method,
        transform=None if method == "none" else np.array(one.result["alignment"]["transform"]),
        reference_name=str(asked.reference),
        estimate_name=one.name,
        detail=detail,
    )


def _row(one: Measured) -> dict[str, Any]:
    found = one.result["alignment"]
    return {**one.result, "alignment": found["method"], "scale": found["scale"]}


def _each(
    place: str | None,
    series: Sequence[ErrorSeries],
    suffix: str,
    writer: Callable[[str | Path, ErrorSeries], None],
) -> None:
    if place is None:
        return
    if len(series) == 1 and not Path(place).is_dir():
        writer(place, series[0])
        return
    folder = Path(place)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise OptionError(f"{place} must be a folder: there are {len(series)} estimates to write") from error
    except OSError as error:
        raise FileError(place, f"can't be made: {error.strerror or error}") from error
    for name, one in zip(_file_names([one.estimate_name for one in series]), series, strict=True):
        writer(folder / f"{name}{suffix}", one)


def _file_names(estimates: Sequence[str]) -> list[str]:
    """Stems of the files; where two are equal, numbered."""
    stems = [Path(name).stem for name in estimates]
    return [
        stem if stems.count(stem) == 1 else f"{stem}-{stems[: k + 1].count(stem)}"
        for k, stem in enumerate(stems)
    ]


def _write_text(path: str, text: str) -> None:
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise FileError(path, f"can't be written: {error.strerror or error}") from error
