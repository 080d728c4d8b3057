# SPDX-License-Identifier: Apache-2.0
"""Names and values of columns in words: "my-icp, lidar, reader not included, frame rate 7.5 Hz"."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.analysis.grouping import SUBJECT
from slamhive.analysis.metrics import title_of
from slamhive.reporting.markup import parse_metric, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

_READER = {True: "reader included", False: "reader not included"}


def column_title(name: str, among: Collection[str] = ()) -> str:
    """Return a column's name for people, with its unit.

    Args:
        name: of the column.
        among: names of the columns beside it, from which it must stay apart.
    """
    return title_of(name, parse_metric(name).unit or None, among)


def keys_text(
    keys: Mapping[str, Any], bare: Iterable[str] = SUBJECT, text: Callable[[Any], str] = shown
) -> str:
    """Return the values that some runs share, in one line, each with its column's name.

    Args:
        keys: values by column.
        bare: columns whose values say by themselves what they are.
        text: writes a value.
    """
    return ", ".join(
        text(value) if name in bare else _named(name, value, keys, text) for name, value in keys.items()
    )


def _named(name: str, value: Any, among: Collection[str], text: Callable[[Any], str]) -> str:
    if name == "usage.includesReader":
        return _READER.get(value, "reader unknown")
    title, _, unit = column_title(name, among).partition(" [")
    if value is None or isinstance(value, str | bool) or not unit:
        return f"{title} {text(value)}"
    metric = parse_metric(name)
    return f"{title} {metric.show(value) if metric.unit else text(value)} {unit.removesuffix(']')}"
