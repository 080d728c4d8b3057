# SPDX-License-Identifier: Apache-2.0
"""Baseline of a gate: a small file with what runs came to, kept in the repository of whoever asks.

It is JSON with the hash of its content, and one of each setting's, so that a change by hand is seen and told
where it is. Numbers of runs stand one by one: what compares with them needs their spread.
"""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from pydantic import Field, ValidationError, model_validator

from slamhive.analysis.gating.cells import GateRuns
from slamhive.model.base import Model, explain
from slamhive.model.canonical import digest, normalize
from slamhive.model.errors import InputError
from slamhive.model.reading import read_text
from slamhive.model.results import Machine
from slamhive.monitor.programs.orphans import write_atomically
from slamhive.reporting.gate.foreign import foreign_baseline

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

SCHEMA: Final = "slamhive-baseline/v1"
MOST_BYTES = 32 << 20
_Sha = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class BaselineCell(Model):
    """A setting on a dataset, with its repetitions.

    Attributes:
        sweep: whose it is.
        settings: the value on each axis of the sweep.
        dataset, dataset_sha256: name and hash of the recording; the hash is None where that isn't known.
        input: what was taken of the recording, and how it was played; None where that isn't known.
        alignment, evaluation: how it was measured: the alignment, and the hash of the settings.
        memory: kind of memory that was measured.
        tracked: of each repetition, whether it was.
        values: of each column a number a repetition, null where there is none.
        sha256: of all other fields.
    """

    sweep: str | None
    settings: dict[str, Any]
    dataset: str | None
    dataset_sha256: _Sha | None = None
    input: dict[str, Any] | None = None
    alignment: str | None = None
    evaluation: str | None = None
    memory: str | None = None
    tracked: list[bool] = Field(min_length=1, max_length=10_000)
    values: dict[str, list[float | None]]
    sha256: _Sha | None = None

    @model_validator(mode="after")
    def _as_many(self) -> BaselineCell:
        for name, numbers in self.values.items():
            if len(numbers) != len(self.tracked):
                raise ValueError(
                    f"values.{name}: {len(numbers)} numbers, but tracked has {len(self.tracked)} repetitions"
                )
        return self

    @property
    def runs(self) -> GateRuns:
        """Repetitions as tests have them."""
        return GateRuns(
            self.tracked,
            {
                name: [math.nan if number is None else number for number in numbers]
                for name, numbers in self.values.items()
            },
        )

    def sealed(self) -> BaselineCell:
        """Return it with the hash of its content."""
        return self.replace(sha256=_hash(self.as_json()))


class Baseline(Model):
    """Record of a gate, to compare with.

    Attributes:
        processor: model of the processor of all runs; None where none is known, or machines were unlike.
        machine: what else says how load was measured, the same for all runs.
        recorded: day.
        version: of slamhive.
        cells: settings on datasets.
        sha256: of all other fields.
    """

    baseline: Literal["slamhive-baseline/v1"] = SCHEMA
    processor: str | None = None
    machine: Machine | None = None
    recorded: str | None = None
    version: str | None = None
    cells: list[BaselineCell] = Field(min_length=1, max_length=100_000)
    sha256: _Sha | None = None

    def sealed(self) -> Baseline:
        """Return it with the hashes of its content."""
        found = self.replace(cells=[cell.sealed() for cell in self.cells])
        return found.replace(sha256=_hash(found.as_json()))

    def write(self, path: Path) -> None:
        """Write it, sealed, one setting a line.

        Raises:
            InputError: it can't be written there.
        """
        body = self.sealed().as_json()
        cells = ",\n  ".join(_text(cell) for cell in body.pop("cells"))
        lines = [f" {_text(name)}: {_text(value)}" for name, value in body.items()]
        lines.append(f' "cells": [\n  {cells}\n ]')
        try:
            write_atomically(str(path), "{\n" + ",\n".join(lines) + "\n}\n")
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}") from None


def _text(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


def _hash(body: Mapping[str, Any]) -> str:
    return digest(normalize({name: value for name, value in body.items() if name != "sha256"}))


def read_baseline(path: Path) -> Baseline:
    """Read a baseline, or one of slam-regression-ci.

    Raises:
        InputError: it is no such file, or isn't as it was recorded.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    if size > MOST_BYTES:
        raise InputError(f"{path}: {size:,} bytes, a baseline has at most {MOST_BYTES >> 20} MiB")
    try:
        body = json.loads(read_text(path), parse_constant=_no_number)
    except json.JSONDecodeError as error:
        raise InputError(f"{path}:{error.lineno}: not JSON: {error.msg}") from None
    except (RecursionError, ValueError) as error:
        raise InputError(f"{path}: not JSON of a baseline: {error}") from None
    body = foreign_baseline(body, str(path)) or body
    if not isinstance(body, dict) or body.get("baseline") != SCHEMA:
        told = body if isinstance(body, dict) else {}
        schema = repr(str(told.get("baseline", told.get("schema", "none")))[:60])
        raise InputError(
            f"{path}: no baseline of a gate: expected baseline: {SCHEMA}, found {schema}; "
            "slamhive gate --record makes one"
        )
    try:
        found = Baseline.model_validate(body)
    except ValidationError as error:
        first = error.errors()[0]
        place = "".join(f"[{one}]" if isinstance(one, int) else f".{one}" for one in first["loc"]).lstrip(".")
        raise InputError(f"{path}: {place}: {explain(first)}") from None
    _check(found, body, path)
    return found


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is no number")


def _check(found: Baseline, body: Mapping[str, Any], path: Path) -> None:
    """Compare hashes with the content.

    Raises:
        InputError: the content is another than was recorded.
    """
    if found.sha256 is None:  # of another program
        return
    help_ = "a baseline is recorded, not written: slamhive gate --record does it anew"
    try:
        for number, (cell, raw) in enumerate(zip(found.cells, body["cells"], strict=True)):
            if cell.sha256 != _hash(raw):
                name = ", ".join(f"{key} {value}" for key, value in cell.settings.items()) or cell.dataset
                raise InputError(f"{path}: cells[{number}] ({name}): not as it was recorded; {help_}")
        if found.sha256 != _hash(body):
            raise InputError(
                f"{path}: sha256 doesn't fit the content: changed since it was recorded; {help_}"
            )
    except ValueError as error:  # an integer or text that has no canonical form
        raise InputError(f"{path}: {error}") from None


def columns_of(cells: Sequence[BaselineCell]) -> set[str]:
    """Return the columns of which any run has a number."""
    return {
        name
        for cell in cells
        for name, numbers in cell.values.items()
        if any(number is not None for number in numbers)
    }
