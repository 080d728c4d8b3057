# SPDX-License-Identifier: Apache-2.0
"""Tables of results as CSV and LaTeX."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

from slamhive_eval.formats.csv_writing import write_csv

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_ESCAPES = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    }
)


def csv_table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Rows as comma-separated values with a line of names; a missing value or None is empty.

    Args:
        rows: One mapping a line.
        columns: Names, in order.

    Returns:
        The text; numbers have every digit that float64 needs.
    """
    text = io.StringIO()
    write_csv(text, columns, ([row.get(name) for name in columns] for row in rows))
    return text.getvalue()


def latex_table(
    rows: Sequence[Mapping[str, Any]],
    columns: Mapping[str, str],
    caption: str,
    digits: int = 4,
    best: Sequence[str] = (),
) -> str:
    """Rows as a LaTeX table with booktabs' rules.

    Args:
        rows: One mapping a line.
        columns: Headings by name, in order; the first column is left-aligned text.
        caption: What it shows; special characters are escaped.
        digits: Significant digits of numbers.
        best: Columns whose smallest number is set in bold.

    Returns:
        The text.
    """
    heads = " & ".join(head.translate(_ESCAPES) for head in columns.values())
    lines = [
        r"% needs \usepackage{booktabs}",
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{caption.translate(_ESCAPES)}}}",
        rf"  \begin{{tabular}}{{l{'r' * (len(columns) - 1)}}}",
        r"    \toprule",
        rf"    {heads} \\",
        r"    \midrule",
    ]
    known = {name: [row[name] for row in rows if row.get(name) is not None] for name in best}
    smallest = {name: min(values) for name, values in known.items() if values}
    for row in rows:
        cells = [_cell(row.get(name), digits, bold=_is_best(row, name, smallest)) for name in columns]
        lines.append(f"    {' & '.join(cells)} \\\\")
    return "\n".join([*lines, r"    \bottomrule", r"  \end{tabular}", r"\end{table}"]) + "\n"


def _is_best(row: Mapping[str, Any], name: str, smallest: Mapping[str, float]) -> bool:
    return name in smallest and row.get(name) == smallest[name]


def _cell(value: Any, digits: int, *, bold: bool) -> str:
    if value is None:
        return "--"
    if isinstance(value, float):
        text = f"{value:.{digits}g}"
        if "e" in text:
            mantissa, exponent = text.split("e")
            text = rf"${mantissa}\times 10^{{{int(exponent)}}}$"
    else:
        text = str(value).translate(_ESCAPES)
    return rf"\textbf{{{text}}}" if bold else text
