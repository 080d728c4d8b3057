# SPDX-License-Identifier: Apache-2.0
"""Program of the preparation's Job: a variant of a dataset, its ground truth, and an algorithm's files.

``python3 -P -m slamhive.jobs.prepare``, with the data volume at ``data`` and ``request/request.json``. Any
number of these may run at the same time: what they make is made aside and renamed when it is whole, under a
lock for what takes long.

Where a program of the Dataset makes the frames, it runs in a container of the same pod: ``--show`` lays out
``work/in`` before it, and this takes what it wrote into ``work/own/out``.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.files.fetching import fetch, require_sha256
from slamhive.data.inspecting.known import FINDINGS, looked_at, require_possible, sensors_used
from slamhive.data.making.preparation import prepare
from slamhive.data.making.programmed import prepare_by_program, show_for_program
from slamhive.data.recordings.entries import dataset_sha256
from slamhive.data.recordings.version import VERSION
from slamhive.data.store.datasets import materialise
from slamhive.data.store.groundtruth import ground_truth, write_ground_truth
from slamhive.jobs.messages import described
from slamhive.jobs.program import Refused, arguments, parse, read_request, run_program, write_aside
from slamhive.jobs.requests import PrepareRequest
from slamhive.model.errors import DataError, InputError
from slamhive.model.results import Reason
from slamhive.model.variant import (
    SUSPICION_LENGTH,
    VariantDescription,
    open_codes,
    program_digest,
    program_title,
    suspicion,
)
from slamhive_eval import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from slamhive.data.making.preparation import Variant
    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.data.store.groundtruth import GroundTruthPoses
    from slamhive.jobs.requests import FetchedAsset
    from slamhive.model.dataset import Dataset
    from slamhive.model.variant import OpenFinding, PreparingProgram

_TELL_SECONDS = 5.0


def main(argv: Sequence[str] | None = None) -> int:
    """Prepare what the request asks for."""
    parser = arguments("Prepare a variant of a dataset.")
    parser.add_argument("--show", action="store_true", help="lay out what a program of the dataset is given")
    options = parser.parse_args(argv)
    work = _show if options.show else _work
    return run_program(lambda: work(options.root), refusal=Reason.PREPARATION_FAILED)


def _show(root: Path) -> str:
    request = parse(PrepareRequest, read_request(root), "request")
    entry, _, _ = _looked_at(request, root / "data")
    own = root / "work" / "own"
    for name in ("out", "home", "tmp"):
        (own / name).mkdir(parents=True, exist_ok=True)
    show_for_program(
        *(entry, request.roles, request.input, root / "data" / "variants"),
        entry.dataset.spec.preparation(request.input.program or ""),
        root / "work" / "in",
        _teller("preparing what the program is given"),
        topics=request.topics or (),
    )
    return described({})


def _looked_at(request: PrepareRequest, data: Path) -> tuple[DatasetEntry, list[OpenFinding], list[str]]:
    """Return the dataset, what is wrong with it, and the names of the sensors that are read.

    Raises:
        SlamHiveError: It isn't there, or can't be used for these sensors.
    """
    dataset, folder = request.dataset, data / "datasets" / request.dataset.name
    _require_files(dataset, folder)
    entry = materialise(dataset, folder, data / "generated", _teller(_making(dataset)))
    found = looked_at(entry, data / "generated" / FINDINGS)
    roles = entry.dataset.spec.recorded_roles(request.roles, request.input.program)
    sensors = sensors_used(entry.dataset.spec, roles, request.input.remap)
    require_possible(entry, found, sensors)
    return entry, found, sensors


def _work(root: Path) -> str:
    request = parse(PrepareRequest, read_request(root), "request")
    data = root / "data"
    entry, found, sensors = _looked_at(request, data)
    for asset in request.assets:
        _place(asset, data / "assets")
    wanted = (entry, request.roles, request.input, request.formats, data / "variants")
    told, topics = _teller("preparing the variant"), request.topics or ()
    maker = _maker(entry, request, root)
    if maker is None:
        variant = prepare(*wanted, told, topics=topics)
    else:
        variant = prepare_by_program(*wanted, maker, told, topics=topics)
    cache = data / "generated" / "truths"
    truth = ground_truth(entry, cache)
    place_truth(entry, truth, data / "groundtruth", cache)
    description = _describe(entry, variant, truth, data / "variants" / ".hashes")
    description = description.replace(prepared_by=maker.digest if maker else None)
    why = suspicion(found, sensors)
    whole = description.replace(findings=open_codes(found, sensors), suspicion=why and why[:SUSPICION_LENGTH])
    return described(whole.as_json())


@dataclass(frozen=True)
class _ShownProgram:
    """A program that has run in a container of this pod, before this one.

    Attributes:
        name: its name.
        dataset: whose it is.
        program: what the Dataset says of it.
        folder: what it was given, as ``in``, and what it wrote, as ``own/out``.
    """

    name: str
    dataset: str
    program: PreparingProgram
    folder: Path

    @property
    def digest(self) -> str:
        """Return the digest that tells it from others, of its image as named: by digest where it has one."""
        return program_digest(self.program)

    def work(self, key: str) -> Path:  # noqa: ARG002
        """Return its folder."""
        return self.folder

    def run(self, work: Path, frames: int, progress: Callable[[float], None]) -> Path:  # noqa: ARG002
        """Return the folder that it wrote into."""
        return work / "own" / "out"

    def failure(self, sentence: str, work: Path) -> InputError:  # noqa: ARG002
        """Return the error of a program of which a sentence tells what it did, and where its log is."""
        log = f"kubectl logs {os.environ.get('HOSTNAME', 'POD')} -c program"
        return InputError(f"{program_title(self.name, self.dataset)} {sentence}; its log: {log}")

    def close(self, work: Path, *, keep_log: bool = False) -> None:
        """Leave all to the pod, with which it goes."""


def _maker(entry: DatasetEntry, request: PrepareRequest, root: Path) -> _ShownProgram | None:
    name = request.input.program
    if name is None:
        return None
    return _ShownProgram(name, entry.name, entry.dataset.spec.preparation(name), root / "work")


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
