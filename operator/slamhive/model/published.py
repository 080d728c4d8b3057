# SPDX-License-Identifier: Apache-2.0
"""Published numbers: rows of the tables of papers and leaderboards, as data beside own results.

Files of the package (``slamhive/published``) and of a home have this form; ``tables.published`` reads them.
"""

from __future__ import annotations

from typing import Annotated, Self

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
    read: str | None = Field(default=None, description="Text in which the numbers were read, and checked.")


class PublishedRow(Model):
    """Numbers of one system on one sequence."""

    system: str = Field(min_length=1, description="Name of the system.")
    sensors: SensorMode | None = Field(default=None, description="Sensor mode, where it is said.")
    dataset: str = Field(min_length=1, description="Sequence, as its publishers call it.")
    parameters: dict[str, Scalar] = Field(default_factory=dict, description="Parameters that are said.")
    values: dict[str, float] = Field(min_length=1, description="Numbers by column, in the table's units.")
    spreads: dict[str, float] = Field(
        default_factory=dict, description="Standard deviations of the repetitions, by column."
    )
    notes: str | None = Field(default=None, description="A sentence, such as a known misprint.")


class PublishedLine(Model):
    """Numbers of one system on several sequences, as papers print them: a row for each number."""

    system: str = Field(min_length=1, description="Name of the system.")
    sensors: SensorMode | None = Field(default=None, description="Sensor mode, where it is said.")
    parameters: dict[str, Scalar] = Field(default_factory=dict, description="Parameters that are said.")
    numbers: list[float | None] = Field(description="A number for each sequence; null: there is none.")
    spreads: list[float] | None = Field(default=None, description="Their standard deviations.")
    notes: str | None = Field(default=None, description="A sentence.")

    def rows(self, column: str, sequences: list[str]) -> list[PublishedRow]:
        """Return the rows that it stands for.

        Raises:
            ValueError: there isn't one number for each sequence.
        """
        for name, found in (("numbers", self.numbers), ("spreads", self.spreads)):
            if found is not None and len(found) != len(sequences):
                raise ValueError(f"{name} of {self.system}: {len(found)} for {len(sequences)} sequences")
        shared = {"system": self.system, "sensors": self.sensors, "parameters": self.parameters}
        none: list[float | None] = [None] * len(sequences)
        spreads = self.spreads or none
        return [
            PublishedRow.model_validate(
                {
                    **shared,
                    "dataset": sequence,
                    "values": {column: number},
                    "spreads": {} if spread is None else {column: spread},
                    "notes": self.notes,
                }
            )
            for sequence, number, spread in zip(sequences, self.numbers, spreads, strict=True)
            if number is not None
        ]


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
    rows: list[PublishedRow] = Field(default_factory=list, description="The rows.")
    column: str | None = Field(default=None, exclude=True, description="Column that lines are of.")
    sequences: list[str] = Field(default_factory=list, exclude=True, description="Sequences of the lines.")
    lines: list[PublishedLine] = Field(
        default_factory=list, exclude=True, description="Rows in short, one a system."
    )

    @model_validator(mode="after")
    def _rows_are_whole(self) -> Self:
        if self.lines:
            if self.column is None or not self.sequences:
                raise ValueError("lines: column and sequences say what their numbers are of")
            found = [row for line in self.lines for row in line.rows(self.column, self.sequences)]
            # Whoever reads a table meets rows alone.
            object.__setattr__(self, "rows", [*self.rows, *found])
        if not self.rows:
            raise ValueError("rows: there is none")
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
    lengths: dict[str, Annotated[float, Field(gt=0)]] = Field(
        default_factory=dict,
        description="Lengths of the true paths in m by sequence, where the catalogue doesn't know them.",
    )
    tables: list[PublishedTable] = Field(min_length=1, description="Its tables.")
