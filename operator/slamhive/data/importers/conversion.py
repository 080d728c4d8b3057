# SPDX-License-Identifier: Apache-2.0
"""Conversion of what an importer found into a dataset: one bag, its ground truth and its manifest."""

from __future__ import annotations

import heapq
import shutil
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.files.publishing import publish
from slamhive.data.files.workers import Workers
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.model.errors import DataError
from slamhive_eval import write_tum

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from slamhive.data.importers.contents import Contents, ImportedTruth
    from slamhive.model.dataset import Dataset

RECORDING = "recording.bag"
_SOME = 64
"""Messages between two signs of life."""


def convert(
    contents: Contents,
    out: Path,
    name: str,
    progress: Callable[[float], None] | None = None,
    also: Mapping[str, Any] | None = None,
) -> Dataset:
    """Turn what was found into a dataset.

    Args:
        contents: What an importer found.
        out: Folder to make: dataset.yaml, recording.bag and the file of the ground truth.
        name: Name of the dataset.
        progress: Called with the share of the messages that are written, 0 to 1, now and then.
        also: What the manifest's spec has beside what was found; it comes first.

    Returns:
        The dataset that is in the folder now.

    Raises:
        DataError: A file is missing or damaged, or there is no message.
        InputError: The folder to make exists.
    """
    if not any(stream.stamps.size for stream in contents.streams):
        raise DataError(f"{name}: no message of any sensor in it")

    def make(aside: Path) -> None:
        _write_bag(aside / RECORDING, contents, progress)
        if contents.truth is not None:
            _write_truth(contents.truth, aside)

    return publish(out, _manifest(contents, name, also or {}), make)


def _write_bag(path: Path, contents: Contents, progress: Callable[[float], None] | None) -> None:
    streams = [stream for stream in contents.streams if stream.stamps.size]
    poses = {stream.frame: np.array(stream.sensor.T_body_sensor) for stream in contents.streams}
    poses.pop(contents.body, None)
    total = sum(stream.stamps.size for stream in streams)
    with BagWriter(path) as bag, Workers() as workers:
        bag.static_transforms(min(int(stream.stamps[0]) for stream in streams), contents.body, poses)
        merged = heapq.merge(*(_events(contents, number) for number in range(len(contents.streams))))
        loaded = workers.ahead(((number, k), _load(contents, number, k)) for _, _, number, k in merged)
        for count, ((number, k), write) in enumerate(loaded):
            if write is None:
                contents.streams[number].write(bag, k)
            else:
                write(bag)
            if progress is not None and count % _SOME == 0:
                progress(count / total)


def _load(contents: Contents, number: int, k: int) -> Callable[[], Callable[[BagWriter], None]] | None:
    load = contents.streams[number].load
    return None if load is None else partial(load, k)


def _events(contents: Contents, number: int) -> Iterator[tuple[int, bool, int, int]]:
    """Yield the messages of a stream as stamp, whether it is a frame, number of the stream, index.

    Of equal stamps the samples come before the frames: a program that got a frame has them all.
    """
    stream = contents.streams[number]
    is_frame = stream.sensor.type.has_frames
    # A list of all would take more memory than the array itself, several times.
    return ((int(stamp), is_frame, number, k) for k, stamp in enumerate(stream.stamps))


def _write_truth(truth: ImportedTruth, folder: Path) -> None:
    target = folder / str(truth.manifest.file)
    if isinstance(truth.source, Path):
        shutil.copyfile(truth.source, target)
    else:
        write_tum(target, truth.source)


def _manifest(contents: Contents, name: str, also: Mapping[str, Any]) -> dict[str, Any]:
    truth = contents.truth
    spec = {
        "description": contents.description,
        "recording": {"format": "Rosbag1", "files": [{"path": RECORDING}]},
        "sensors": {stream.name: stream.sensor.as_json() for stream in contents.streams},
        "groundTruth": truth.manifest.as_json() if truth else None,
        "gravityAligned": contents.gravity_aligned,
    }
    spec |= also
    spec["attributes"] = contents.attributes | dict(also.get("attributes") or {}) or None
    return {"apiVersion": "slamhive.io/v1alpha1", "kind": "Dataset", "metadata": {"name": name}, "spec": spec}
