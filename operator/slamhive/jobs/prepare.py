# SPDX-License-Identifier: Apache-2.0
"""Program of the preparation's Job: a variant of a dataset, its ground truth, and an algorithm's files.

``python3 -P -m slamhive.jobs.prepare``, with the data volume at ``data`` and ``request/request.json``. Any
number of these may run at the same time: what they make is made aside and renamed when it is whole, under a
lock for what takes long.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.files.fetching import fetch, require_sha256
from slamhive.data.inspecting.known import FINDINGS, looked_at, require_possible, sensors_used
from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.entries import dataset_sha256
from slamhive.data.recordings.version import VERSION
from slamhive.data.store.datasets import materialise
from slamhive.data.store.groundtruth import ground_truth, write_ground_truth
from slamhive.jobs.messages import described
from slamhive.jobs.program import Refused, arguments, parse, read_request, run_program, write_aside
from slamhive.jobs.requests import PrepareRequest
from slamhive.model.errors import DataError
from slamhive.model.results import Reason
from slamhive.model.variant import SUSPICION_LENGTH, VariantDescription, open_codes, suspicion
from slamhive_eval import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from slamhive.data.making.preparation import Variant
    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.data.store.groundtruth import GroundTruthPoses
    from slamhive.jobs.requests import FetchedAsset
    from slamhive.model.dataset import Dataset

_TELL_SECONDS = 5.0


def main(argv: Sequence[str] | None = None) -> int:
    """Prepare what the request asks for."""
    options = arguments("Prepare a variant of a dataset.").parse_args(argv)
    return run_program(lambda: _work(options.root), refusal=Reason.PREPARATION_FAILED)


def _work(root: Path) -> str:
    request = parse(PrepareRequest, read_request(root), "request")
    data = root / "data"
    dataset, folder = request.dataset, data / "datasets" / request.dataset.name
    _require_files(dataset, folder)
    entry = materialise(dataset, folder, data / "generated", _teller(_making(dataset)))
    found = looked_at(entry, data / "generated" / FINDINGS)
    sensors = sensors_used(entry.dataset.spec, request.roles, request.input.remap)
    require_possible(entry, found, sensors)
    for asset in request.assets:
        _place(asset, data / "assets")
    variant = prepare(
        *(entry, request.roles, request.input, request.formats, data / "variants"),
        progress=_teller("preparing the variant"),
        topics=request.topics or (),
    )
    cache = data / "generated" / "truths"
    truth = ground_truth(entry, cache)
    place_truth(entry, truth, data / "groundtruth", cache)
    description = _describe(entry, variant, truth, data / "variants" / ".hashes")
    why = suspicion(found, sensors)
    told = description.replace(findings=open_codes(found, sensors), suspicion=why and why[:SUSPICION_LENGTH])
    return described(told.as_json())


def _making(dataset: Dataset) -> str:
    if dataset.spec.is_to_fetch:
        return f"fetching {dataset.spec.catalogue}"
    return "generating the recording"


def _require_files(dataset: Dataset, folder: Path) -> None:
    """Check that what can't be fetched is there.

    Raises:
        Refused: it isn't.
    """
    truth, recording = dataset.spec.ground_truth, dataset.spec.recording
    needed = [("recording.files", file.path) for file in recording.files if file.url is None]
    if truth is not None and recording.synthetic is None and not dataset.spec.is_to_fetch:
        needed += [("groundTruth.file", truth.file or ""), ("groundTruth.times", truth.times or "")]
    for field, path in needed:
        if path and not (folder / path).exists():
            raise Refused(
                Reason.DATASET_MISSING, f"dataset {dataset.name!r}: {field}: {folder / path} does not exist"
            )


def _place(asset: FetchedAsset, folder: Path) -> None:
    """Have an algorithm's file on the volume under its checksum."""
    place = folder / asset.sha256
    where = f"assets: {asset.name}"
    if place.is_file():
        try:
            require_sha256(place, asset.sha256, where)
        except DataError:
            pass
        else:
            return
    folder.mkdir(parents=True, exist_ok=True)
    write_aside(place, partial(_fetch, asset, where), mode=0o444)


def _fetch(asset: FetchedAsset, where: str, aside: Path) -> None:
    print(f"fetching {asset.name} from {asset.url}", file=sys.stderr, flush=True)  # noqa: T201
    fetch(asset.url, aside, asset.sha256, where)


def place_truth(entry: DatasetEntry, truth: GroundTruthPoses | None, folder: Path, cache: Path) -> None:
    """Lay a dataset's ground truth where evaluators find it.

    ``NAME.txt`` are poses, ``NAME.positions`` and ``NAME.points`` positions and control points (``t x y z``),
    ``NAME.relations`` relations. ``NAME.rotations.npy`` are the rotation matrices of a file that holds such:
    they are orthonormal to their digits only, which errors have in them.

    Raises:
        DataError: it can't be read.
        OSError: the disk refuses.
    """
    folder.mkdir(parents=True, exist_ok=True)
    poses = None if truth is None else truth.poses
    wanted: dict[str, Callable[[Path], object]] = {}
    if truth is not None:
        wanted["txt" if truth.kind == "poses" else truth.kind] = partial(
            write_ground_truth, entry, truth, cache=cache
        )
    if isinstance(poses, Trajectory) and poses.rotations is not None:
        wanted["rotations.npy"] = partial(_write_array, poses.rotations)
    for ending in ("txt", "relations", "points", "positions", "rotations.npy"):
        place = folder / f"{entry.name}.{ending}"
        if ending in wanted:
            write_aside(place, wanted[ending])
        else:
            place.unlink(missing_ok=True)


def _write_array(array: np.ndarray[Any, Any], path: Path) -> None:
    with path.open("wb") as file:  # numpy would add an ending to the name
        np.save(file, array, allow_pickle=False)


def _describe(
    entry: DatasetEntry, variant: Variant, truth: GroundTruthPoses | None, hashes: Path
) -> VariantDescription:
    """Return the description of a variant for the operator."""
    files = [path for path in variant.folder.rglob("*") if path.is_file()]
    spec = entry.dataset.spec
    return VariantDescription(
        folder=variant.folder.name,
        format=variant.format,
        recording=variant.path.name,
        sensors=dict(variant.sensors),
        start_time=variant.start_time,
        duration_seconds=variant.duration_seconds,
        frame_rate=variant.frame_rate,
        resolution=variant.resolution,
        frames=variant.frames,
        recorded_frame_rate=variant.recorded_frame_rate,
        recorded_seconds=variant.recorded_seconds,
        key=variant.key,
        source_sha256=variant.source_sha256,
        dataset_sha256=dataset_sha256(entry, hashes),
        size_bytes=sum(path.stat().st_size for path in files),
        ground_truth=None if truth is None else truth.kind,
        T_body_frame=None if truth is None else truth.T_body_frame.tolist(),
        extrinsics={name: sensor.T_body_sensor for name, sensor in spec.sensors.items()}
        | {view.name: view.T_body_sensor for view in variant.sensors.values()},
        gravity_aligned=spec.has_level_truth,
        attributes=dict(spec.attributes),
        preparation_version=VERSION,
    )


def _teller(what: str) -> Callable[[float], None]:
    """Return a function that tells the log the progress of something, every few seconds."""
    told = float("-inf")

    def progress(share: float) -> None:
        nonlocal told
        now = time.monotonic()
        if now - told >= _TELL_SECONDS or share >= 1.0:
            told = now
            print(f"{what}: {100 * share:.0f} %", file=sys.stderr, flush=True)  # noqa: T201

    return progress


if __name__ == "__main__":
    sys.exit(main())
