# SPDX-License-Identifier: Apache-2.0
"""Odd runs: rows of an archive of which one column holds what no program of ours would have written.

``VALUES`` go into every column of runs and results. ``spoil`` adds runs to a made-up archive of which no view
may show anything, as none of them can be read, and nothing else may change.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing, suppress
from typing import TYPE_CHECKING, Any

from slamhive.archive import schema

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from random import Random

NO_DOCUMENTS: tuple[Any, ...] = (
    *(
        '"x"',
        "{",
        "1",
        "[[[[[[",
        "[99999999999]",
        "[1]",
        '["x"]',
        "[1,2,3]",
        "NaN",
        "",
        "[[1,[2]]]",
        "[true]",
    ),
    *("[-1,{}]", "[9223372036854775808]", "[" * 100_000, '{"a":' * 5000 + "1" + "}" * 5000, "1e999", "{},{}"),
    *('{"a":1e999}', '"\\ud800"', '{"\\udc00":1}', "[" * 300 + "]" * 300, b"\xff\xfe", b"{}", 7, 2.5),
)
"""Values of documents that are none; an object with nothing in it would be one."""

VALUES: tuple[Any, ...] = (
    *NO_DOCUMENTS,
    *("[]", "null", "{}", '{"\\u0000":1}', '{"a":[[1],[2]],"b":{"c":[{}]}}', f'{{"n":1{"0" * 300}}}'),
    *('{"parameters":1,"input":"x"}', '{"datasetRef":{"name":[]}}', '{"datasetRef":7}', '{"run":[1]}', "now"),
    *('{"x":"' + "y" * 300 + '"}', "0001-01-01 00:00:00.000000", "9999-12-31", "a\0b", "\x1b[31m", -1, 2**62),
    *('[{"evaluation":[1]}]', '[{"a":1}]', "1999-99-99", "\u202e", 1e300, None),
)

_NO_WORDS = ("x", b"x", "")
_SURELY: dict[str, tuple[Any, ...]] = {
    **dict.fromkeys(("spec", "attributes", "labels", "metrics", "usage"), NO_DOCUMENTS),
    **dict.fromkeys(("frames", "trajectory", "provenance", "evaluations"), NO_DOCUMENTS),
    **dict.fromkeys(("created", "started", "finished"), (*_NO_WORDS, "0001-01-01", 7, "[1]")),
    **dict.fromkeys(("phase", "reason"), ("x", b"x", 7)),
    **dict.fromkeys(("repetition", "seed", "point", "attempts", "cpu_seconds", "wall_seconds"), _NO_WORDS),
    **dict.fromkeys(("name", "sensors", "sweep", "algorithm", "folder"), (b"x", b"\xff")),
}


def put(connection: sqlite3.Connection, like: int, table: str, column: str, value: Any) -> int | None:
    """Add a run like another one, with a value in a column of it or of its results; None if it is refused.

    Returns:
        Its id.
    """
    names = [one.name for one in schema.runs.columns if one.name not in {"id", "uid"}]
    quoted = ", ".join(f'"{name}"' for name in names)
    number = connection.execute("SELECT max(id) + 1 FROM runs").fetchone()[0]
    connection.execute("SAVEPOINT one")
    try:
        connection.execute(
            f"INSERT INTO runs (id, uid, {quoted}) SELECT ?, ?, {quoted} FROM runs WHERE id = ?",
            (number, f"odd-{number}", like),
        )
        if table == "results":
            connection.execute(
                "INSERT INTO results VALUES (?, 'odd', 'Tracked', 1, '', 1, 1, 1, '{}')", (number,)
            )
        key = "id" if table == "runs" else "run_id"
        connection.execute(f'UPDATE {table} SET "{column}" = ? WHERE {key} = ?', (value, number))
    except sqlite3.Error:
        connection.execute("ROLLBACK TO one")
        return None
    return number


def all_values() -> Iterator[tuple[str, str, Any]]:
    """Go through tables and columns that can hold anything, with each of the values."""
    for table in (schema.runs, schema.results):
        for column in table.columns:
            if column.name not in {"id", "run_id", "sweep_uid"}:
                for value in VALUES:
                    yield table.name, column.name, value


def spoil(file: Path, random: Random) -> None:
    """Add some runs to an archive that can't be read."""
    with closing(sqlite3.connect(file)) as connection, connection:
        ids = [number for (number,) in connection.execute("SELECT id FROM runs")]
        for _ in range(random.choice((1, 1, 2, 5)) if ids else 0):
            column = random.choice(list(_SURELY))
            put(connection, random.choice(ids), "runs", column, random.choice(_SURELY[column]))
        with suppress(IndexError):
            what = random.choice((("outcome", "x"), ("values", "1"), ("coverage", "x"), ("values", "[1]")))
            put(connection, random.choice(ids), "results", *what)
