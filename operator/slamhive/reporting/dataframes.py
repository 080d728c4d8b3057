# SPDX-License-Identifier: Apache-2.0
"""Results as data frames of pandas or polars: what ``slamhive.results`` calls."""

from __future__ import annotations

import json
import os
import uuid
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import ColumnKind
from slamhive.analysis.selection import Selection, choose
from slamhive.archive.connection import shown
from slamhive.model import extras
from slamhive.model.errors import UnknownNameError
from slamhive.tables.homes import homes_beside, read_homes
from slamhive.tables.reading import archive_url, home_of, read_archive

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

    from slamhive.analysis.columns import Column
    from slamhive.analysis.frame import Frame
    from slamhive.local.home.folder import Home
    from slamhive.tables.homes import Beside

MARK = "slamhive.results"
REMEMBERED = 16
"""Data frames whose rows are kept, so that figures can be drawn of them."""

_MADE_FROM: dict[str, tuple[Frame, Home, Sequence[Beside]]] = {}


def results(
    place: str | os.PathLike[str] | None,
    *,
    where: str | None,
    columns: str | Sequence[str] | None,
    sweep: str | Sequence[str] | None,
    evaluation: str | None,
    superseded: bool,
    reused: bool,
    also: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None,
    frame: str,
) -> Any:
    """Return the archive's rows as a data frame; see ``slamhive.results``."""
    if frame not in MAKERS:
        raise UnknownNameError("kind of data frame", str(frame), MAKERS, "frame")
    library = extras.library(frame, frame, f"frame={frame!r}")
    sweeps = () if sweep is None else (sweep,) if isinstance(sweep, str) else tuple(sweep)
    selection = Selection(sweeps, evaluation, where, superseded=superseded, each=reused)
    own = replace(home_of(place), archive_url=archive_url(place))
    others = homes_beside(own, _places(place, also), "also")
    found = read_homes(own, others, keep=False) if others else read_archive(own.archive_url)
    meant = choose(found, selection)
    chosen = meant.frame
    if not len(chosen):
        # A chart of nothing is an empty frame, and says nothing of why.
        asked = "; ".join(selection.sentences)
        rows = (
            f"{shown(own.archive_url)} has {len(found):,} rows, and none is meant{asked and f' by {asked}'}"
        )
        warnings.warn("; ".join((rows, *meant.notes)), stacklevel=3)
    wanted = columns.split(",") if isinstance(columns, str) else columns
    names = chosen.names if wanted is None else list(dict.fromkeys(name.strip() for name in wanted))
    chosen.require(names, "columns")
    made = MAKERS[frame](library, chosen, names)
    if frame == "pandas":
        made.attrs[MARK] = _remember(chosen, own, others)
    return made


def _places(
    own: str | os.PathLike[str] | None, also: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None
) -> list[str] | None:
    """Return the other homes that are meant; None for those of the environment."""
    if also is None:
        return None if own is None else []
    return [os.fspath(one) for one in ([also] if isinstance(also, str | os.PathLike) else also)]


def _remember(frame: Frame, home: Home, others: Sequence[Beside]) -> str:
    """Keep what a data frame was made from, and return the key under which it is kept.

    The key alone goes with the data frame: pandas writes attributes into files.
    """
    key = uuid.uuid4().hex
    _MADE_FROM[key] = frame, home, others
    while len(_MADE_FROM) > REMEMBERED:
        del _MADE_FROM[next(iter(_MADE_FROM))]
    return key


def source(frame: Any) -> tuple[Frame, Home, Sequence[Beside]] | None:
    """Return the rows that a data frame of pandas was made from; None where it is none of the last ones.

    These are the rows of the archive's table and the homes that have the files of their runs: one's own, and
    the other ones.
    """
    return _MADE_FROM.get(frame.attrs.get(MARK, ""))


def _pandas(library: Any, frame: Frame, names: Sequence[str]) -> Any:
    return library.DataFrame({name: _pandas_column(library, frame.column(name)) for name in names})


def _pandas_column(library: Any, column: Column) -> Any:
    missing = ~column.present
    match column.kind:
        case ColumnKind.NUMBER:
            return column.numbers.copy()
        case ColumnKind.INTEGER:
            whole = np.where(missing, 0, column.numbers).astype(np.int64)
            return library.arrays.IntegerArray(whole, missing) if missing.any() else whole
        case ColumnKind.BOOLEAN:
            held = column.numbers > 0
            return library.arrays.BooleanArray(held, missing) if missing.any() else held
        case ColumnKind.TIME:
            return library.Series(_microseconds(column)).dt.tz_localize("UTC")
        case ColumnKind.TEXT:
            return library.Series(column.tolist(), dtype="str" if _major(library) >= 3 else object)
        case _:
            return library.Series(column.tolist(), dtype=object)


def _polars(library: Any, frame: Frame, names: Sequence[str]) -> Any:
    return library.DataFrame([_polars_column(library, name, frame.column(name)) for name in names])


def _polars_column(library: Any, name: str, column: Column) -> Any:
    match column.kind:
        case ColumnKind.NUMBER:
            return library.Series(name, column.numbers, nan_to_null=True)
        case ColumnKind.INTEGER:
            return library.Series(name, column.numbers, nan_to_null=True).cast(library.Int64)
        case ColumnKind.BOOLEAN:
            return library.Series(name, column.numbers, nan_to_null=True).cast(library.Boolean)
        case ColumnKind.TIME:
            return library.Series(name, _microseconds(column)).dt.replace_time_zone("UTC")
        case _:
            return library.Series(name, [_text(value) for value in column.tolist()], dtype=library.String)


def _microseconds(column: Column) -> npt.NDArray[np.datetime64]:
    whole = np.round(np.where(column.present, column.numbers, 0.0) * 1e6).astype(np.int64)
    stamps = whole.astype("datetime64[us]")
    stamps[~column.present] = np.datetime64("NaT")
    return stamps


def _text(value: Any) -> str | None:
    if value is None or isinstance(value, str):
        return value
    return json.dumps(value)


MAKERS: dict[str, Callable[[Any, Frame, Sequence[str]], Any]] = {"pandas": _pandas, "polars": _polars}
"""By the name of the library."""


def _major(library: Any) -> int:
    return int(str(library.__version__).partition(".")[0])
