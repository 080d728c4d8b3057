# SPDX-License-Identifier: Apache-2.0
"""Values of a result that a MappingRun's status types, whoever measured them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import ConfigDict, Field, ValidationError, create_model

from slamhive.model.base import Model, explain, optional
from slamhive_eval.statistics import STATISTICS

if TYPE_CHECKING:
    from collections.abc import Mapping

MOST_RPE = 16
_SHOWN = 60

_FIELDS: dict[str, Any] = {name: (float | None, optional(f"{name} of the error.")) for name in STATISTICS}


class ErrorFigures(create_model("_Statistics", __base__=Model, **_FIELDS)):  # type: ignore[misc]
    """Statistics of an error; an evaluator may add its own."""

    model_config = ConfigDict(extra="ignore", strict=True)


class ReportedValues(Model):
    """The typed ones among a result's values; others are kept as they are."""

    model_config = ConfigDict(extra="ignore", strict=True)

    scale: float | None = None
    ate: ErrorFigures | None = None
    rpe: list[dict[str, Any]] | None = Field(default=None, max_length=MOST_RPE)


def problem_of_values(values: Mapping[str, Any]) -> str | None:
    """Say which of a result's values a status can't hold, and why; None where it holds them all."""
    try:
        ReportedValues.model_validate(dict(values))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        return f"{place}: {explain(first)}, found {str(first['input'])[:_SHOWN]!r}"
    return None
