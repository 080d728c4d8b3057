# SPDX-License-Identifier: Apache-2.0
"""Values as text that YAML 1.1, YAML 1.2 and OpenCV's FileStorage read as the same."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

Matrix = list[list[float]]


class HelperProblem(ValueError):  # noqa: N818 - what a template asked for, said in a sentence
    """A function of a template was asked for what can't be."""


def number(value: Any) -> str:
    """Return a number as its shortest text that is read as the same one; a float always has a point.

    >>> number(1e-05), number(460.0), number(3)
    ('1.0e-05', '460.0', '3')
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise HelperProblem(f"number: expected a number, found {shown(value)}")
    if isinstance(value, int):
        return str(value)
    if not math.isfinite(value):
        raise HelperProblem(f"{value} is not a finite number")
    text = repr(value)
    # YAML 1.1 takes 1e-05 for text.
    return text if "." in text else text.replace("e", ".0e")


def plain(value: Any) -> str:
    """Return a value as ``{{ … }}`` prints it.

    A truth value is true or false, nothing is null, a list stands in brackets, texts in it in quotes; a text
    by itself stands as it is.
    """
    if isinstance(value, str):
        return value
    return _flow(value)


def quoted(value: Any) -> str:
    """Return a text in double quotes, escaped as JSON, YAML and FileStorage read it."""
    if not isinstance(value, str):
        raise HelperProblem(f"quoted: expected a text, found {shown(value)}")
    return json.dumps(value, ensure_ascii=False)


def opencv_matrix(matrix: Any, indent: int = 3) -> str:
    """Return a matrix as OpenCV's FileStorage writes it, of doubles, to be put after a key and a colon.

    Args:
        matrix: rows of numbers; a list of numbers is a column.
        indent: blanks before each further line; more than the key has.
    """
    rows = [[item] for item in matrix] if _is_list(matrix) and not _is_matrix(matrix) else matrix
    checked = rows_of(rows, "opencv_matrix")
    if isinstance(indent, bool) or not isinstance(indent, int) or not 1 <= indent <= 64:
        raise HelperProblem(f"opencv_matrix: indent must be a whole number from 1 to 64, not {shown(indent)}")
    start = "\n" + " " * indent
    lines = [f"rows: {len(checked)}", f"cols: {len(checked[0])}", "dt: d"]
    texts = [", ".join(number(item) for item in row) for row in checked]
    data = ("," + start + " " * 7).join(texts)
    return "!!opencv-matrix" + start + start.join([*lines, f"data: [{data}]"])


def row_major(matrix: Any) -> list[float]:
    """Return the values of a matrix row by row, as one list."""
    return [item for row in rows_of(matrix, "row_major") for item in row]


def rows_of(matrix: Any, who: str) -> Matrix:
    """Return a matrix of floats, after checking that it is one."""
    if not _is_matrix(matrix) or len({len(row) for row in matrix}) != 1:
        raise HelperProblem(f"{who}: expected a matrix (rows of equal length), found {shown(matrix)}")
    if not all(
        isinstance(item, int | float) and not isinstance(item, bool) for row in matrix for item in row
    ):
        raise HelperProblem(f"{who}: expected a matrix of numbers, found {shown(matrix)}")
    return [[float(item) for item in row] for row in matrix]


def shown(value: Any) -> str:
    """Return a value as a sentence names it."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:60]}…"


def _flow(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, int | float):
        return number(value)
    if _is_list(value):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    if isinstance(value, dict):
        names = ", ".join(str(name) for name in list(value)[:12])
        raise HelperProblem(f"it has several fields, name one of them: {names}")
    raise HelperProblem("it is no value that can be printed; are its brackets missing?")


def _is_list(value: Any) -> bool:
    return isinstance(value, list | tuple | range)


def _is_matrix(value: Sequence[Any]) -> bool:
    return _is_list(value) and len(value) > 0 and all(_is_list(row) and len(row) > 0 for row in value)
