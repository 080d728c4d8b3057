# SPDX-License-Identifier: Apache-2.0
"""Recordings with a fault, made of a clean one: each message passes a function that may change it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.repairing import open_recording
from slamhive.data.recordings.writing import RecordingWriter
from slamhive.model.dataset import Dataset

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.data.doctor.findings import Finding


def spoil(
    clean: DatasetEntry, folder: Path, change: Callable[[str, Any], Any], spec: dict[str, Any] | None = None
) -> DatasetEntry:
    """Write a dataset anew with changed messages.

    Args:
        clean: The dataset; its recording is one file.
        folder: Where to, made if need be.
        change: From a topic and a decoded message to the message to be written, None to leave it out.
        spec: Fields of the spec that are other ones.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stated = clean.dataset.spec
    name = clean.dataset.spec.recording.files[0].path.rsplit("/", 1)[-1]
    with (
        open_recording(clean.dataset, clean.root) as recording,
        RecordingWriter(recording, folder / name, stated.recording.format) as writer,
    ):
        for connection, time, raw in recording.messages(recording.topics):
            message = change(connection.topic, recording.decode(raw, connection.msgtype))
            if message is not None:
                writer.write(connection, time, recording.encode(message, connection.msgtype))
    values = clean.dataset.as_json()
    values["spec"]["recording"] = {"format": stated.recording.format, "files": [{"path": name}]}
    values["spec"] |= spec or {}
    truth = stated.ground_truth
    if truth is not None and truth.file is not None:
        (folder / truth.file).parent.mkdir(parents=True, exist_ok=True)
        (folder / truth.file).write_bytes((clean.root / truth.file).read_bytes())
    return DatasetEntry(Dataset.model_validate(values), folder)


def found_in(entry: DatasetEntry) -> dict[str, Finding]:
    """Return the findings of a dataset by code, the first of each."""
    found: dict[str, Finding] = {}
    for finding in inspect(entry).findings:
        found.setdefault(finding.code, finding)
    return found
