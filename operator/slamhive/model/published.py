# SPDX-License-Identifier: Apache-2.0
"""Published numbers: rows of the tables of papers and leaderboards, as data beside own results.

Files of the package (``slamhive/published``) and of a home have this form; ``tables.published`` reads them.
"""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from slamhive.model.base import Choice, Model, Scalar
from slamhive.model.evaluation import Alignment
from slamhive.model.sensors import SensorMode


class PublishedStatistic(Choice):
    """Statistics that a published number can be: a single run, or mean, median or best of several."""

    SINGLE = "Single"
    MEAN = "Mean"
    MEDIAN = "Median"
    BEST = "Best"


class PublishedSource(Model):
    """Publication that numbers are taken from: a paper, or a leaderboard."""

    title: str = Field(min_length=1, description="Title of the paper, or name of the leaderboard.")
    authors: list[str] = Field(default_factory=list, description="Those who published them.")
    venue: str | None = Field(default=None, description="Conference, journal or site.")
    year: int | None = Field(default=None, ge=1950, le=2100, description="Year of publication.")
    url: str | None = Field(default=None, pattern=r"^https?://", description="Address where it can be read.")
    doi: str | None = Field(default=None, pattern=r"^10\.", description="Its DOI.")


class PublishedRow(Model):
    """Numbers of one system on one sequence."""

    system: str = Field(min_length=1, description="Name of the system.")
    sensors: SensorMode | None = Field(default=None, description="Sensor mode, where it is said.")
    dataset: str = Field(min_length=1, description="Sequence, as its publishers call it.")
    parameters: dict[str, Scalar] = Field(default_factory=dict, description="Parameters that are said.")
    values: dict[str, float] = Field(min_length=1, description="Numbers by column, in the table's units.")
    notes: str | None = Field(default=None, description="A sentence, such as a known misprint.")


class PublishedTable(Model):
    """Rows of one table, and what holds for all of them."""

    place: str = Field(min_length=1, description="Table or page.")
    alignment: Alignment | None = Field(default=None, description="Alignment; none: it isn't said.")
    statistic: PublishedStatistic | None = Field(default=None, description="Statistic that the numbers are.")
    runs: int | None = Field(default=None, ge=1, description="Repetitions behind each number.")
    poses: str | None = Field(default=None, description="Poses that are measured: all frames, keyframes, …")
    frame: str | None = Field(default=None, description="Whose poses are measured: body, camera, …")
    truth: str | None = Field(default=None, description="Ground truth, where not the publishers' own.")
    units: dict[str, str] = Field(default_factory=dict, description="Units, by column; default: as stored.")
    rows: list[PublishedRow] = Field(min_length=1, description="The rows.")

    @model_validator(mode="after")
    def _units_are_used(self) -> Self:
        columns = {name for row in self.rows for name in row.values}
        for name in self.units:
            if name not in columns:
                raise ValueError(f"units: no row has the column {name!r}")
        return self


class PublishedNumbers(Model):
    """A file of published numbers."""

    source: PublishedSource = Field(description="Paper or leaderboard that has them.")
    families: dict[str, list[str]] = Field(
        default_factory=dict, description="Sequences by family: a dataset FAMILY-SEQUENCE is meant too."
    )
    tables: list[PublishedTable] = Field(min_length=1, description="Its tables.")
