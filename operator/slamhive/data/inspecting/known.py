# SPDX-License-Identifier: Apache-2.0
"""Findings of recordings that were looked at before, kept for plans and runs.

They hold as long as the files, and what their manifest says of them, stay as they were. What a run meets for
the first time is looked at in a sample.
"""

from __future__ import annotations

import json
import os
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from slamhive import __version__
from slamhive.data.recordings.entries import state_of
from slamhive.data.store.datasets import files_of
from slamhive.model.canonical import digest
from slamhive.model.errors import DataError
from slamhive.model.variant import OpenFinding, preventing

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
    from pathlib import Path

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.model.dataset import DatasetSpec
    from slamhive.model.sensors import Role

FINDINGS = "findings"
"""Folder of a home in which they are kept."""


def keep(entry: DatasetEntry, findings: Sequence[Finding], folder: Path, *, is_sample: bool) -> None:
    """Keep the findings of a dataset; those of a sample never take the place of those of all messages.

    Args:
        entry: The dataset, materialised.
        findings: What was found.
        folder: Where they are kept.
        is_sample: Whether no more than a sample was read.
    """
    with suppress(OSError):  # It is found out again then.
        place = _place(entry, folder)
        if is_sample and place.exists():
            return
        body = {
            "dataset": entry.name,
            "isSample": is_sample,
            "findings": [finding.as_known.as_json() for finding in findings],
        }
        folder.mkdir(parents=True, exist_ok=True)
        aside = place.with_name(f".{place.name}.{os.urandom(6).hex()}")
        aside.write_text(json.dumps(body, indent=2) + "\n", encoding="utf-8")
        aside.replace(place)


def known(entry: DatasetEntry, folder: Path) -> list[OpenFinding] | None:
    """Return the findings of a dataset that were kept; None where it wasn't looked at as it is.

    Args:
        entry: The dataset, materialised.
        folder: Where they are kept.
    """
    try:
        found = json.loads(_place(entry, folder).read_text(encoding="utf-8"))
        return [OpenFinding.model_validate(one) for one in found["findings"]]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def looked_at(entry: DatasetEntry, folder: Path) -> list[OpenFinding]:
    """Return the findings of a dataset, of a sample of its messages where it wasn't looked at as it is.

    What can't be read has none: preparing it says why.

    Args:
        entry: The dataset, materialised.
        folder: Where they are kept.
    """
    before = known(entry, folder)
    if before is not None:
        return before
    # With OpenCV, for those who look for the first time.
    from slamhive.data.inspecting.quick import quick_findings  # noqa: PLC0415

    try:
        found = quick_findings(entry)
    except DataError:
        return []
    keep(entry, found, folder, is_sample=True)
    return [finding.as_known for finding in found]


def sensors_used(spec: DatasetSpec, roles: Iterable[Role], remap: dict[str, str]) -> list[str]:
    """Return the names of the sensors that runs of some roles read.

    Raises:
        InputError: The dataset has no sensor for a role.
    """
    return [spec.sensor_for(role, remap) for role in roles]


def require_possible(entry: DatasetEntry, findings: Iterable[OpenFinding], sensors: Collection[str]) -> None:
    """Refuse runs with the sensors of some names that a finding makes impossible.

    Args:
        entry: The dataset.
        findings: What is known to be wrong with it.
        sensors: Names of the sensors.

    Raises:
        DataError: With the finding and its repair.
    """
    if fault := preventing(findings, sensors):
        raise DataError(
            f"dataset {entry.name!r}: runs with {', '.join(sensors)} aren't started: {fault.sentence}"
        )


def _place(entry: DatasetEntry, folder: Path) -> Path:
    """Return the file of a dataset's findings, by the state of its files and all that is said of them.

    Raises:
        OSError: A file can't be looked at.
    """
    spec = entry.dataset.spec
    truth = spec.ground_truth
    files = [
        state_of(file)
        for path in files_of(entry.dataset)
        for root in (entry.root / path,)
        for file in (sorted(root.rglob("*")) if root.is_dir() else [root])
    ]
    parts: dict[str, Any] = {
        "version": __version__,
        "files": files,
        "sensors": {name: sensor.as_json() for name, sensor in spec.sensors.items()},
        "groundTruth": truth.as_json() if truth else None,
        "repair": spec.repair.as_json() if spec.repair else None,
    }
    return folder / f"{digest(parts)}.json"
