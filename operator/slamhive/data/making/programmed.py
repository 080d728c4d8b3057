# SPDX-License-Identifier: Apache-2.0
"""Variants whose frames a program of the user's made: a Dataset names it, a run asks for it by that name.

The program is given the frames of the variant without it, after all other options. What it makes of them is a
recording of its own in the cache, by the hash of that variant and of the program, and the run's variant is
prepared of it as of any other recording.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

from slamhive.data.files.once import make_once
from slamhive.data.making.frames import show_frames, shown_frames, take_frames
from slamhive.data.making.preparation import prepare, recording_state, variant_folder, variant_key
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.model.canonical import digest
from slamhive.model.configuration import SensorView
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, InputError
from slamhive.model.formats import FILE_NAMES, DataFormat
from slamhive.model.run import TOLD, InputOptions, Perturbation

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from slamhive.data.making.preparation import Variant
    from slamhive.model.sensors import Role
    from slamhive.model.variant import PreparingProgram

_DESCRIPTION = "prepared.json"
_VERSION = 1


class FrameMaker(Protocol):
    """A preparing program that can be started."""

    @property
    def name(self) -> str:
        """Return its name."""

    @property
    def program(self) -> PreparingProgram:
        """Return the Dataset's description of it."""

    @property
    def digest(self) -> str:
        """Return the digest that tells it from others."""

    def work(self, key: str) -> Path:
        """Return an empty folder, in which what it is given is laid as ``in``."""

    def run(self, work: Path, frames: int, progress: Callable[[float], None]) -> Path:
        """Run it, and return the folder that it wrote into.

        Args:
            work: The folder.
            frames: How many it is given.
            progress: Called with the share done, 0 to 1.

        Raises:
            InputError: It failed; the sentence has the program as subject.
        """

    def failure(self, sentence: str, work: Path) -> InputError:
        """Return the error of a program of which a sentence tells what it did, with the end of its log."""

    def close(self, work: Path, *, keep_log: bool = False) -> None:
        """Remove the folder, or all of it but the log."""


@dataclass(frozen=True)
class _WantedVariant:
    """Input that a run asks for, in two parts: that given to the program, and that prepared of its frames."""

    recorded: tuple[Role, ...]
    before: InputOptions
    after: InputOptions


def _wanted(roles: Sequence[Role], options: InputOptions, program: PreparingProgram) -> _WantedVariant:
    recorded = program.recorded(roles)
    remap = {role: name for role, name in options.remap.items() if role in map(str, recorded)}
    told = options.perturb.as_json() if options.perturb else {}
    # What an algorithm is told wrongly is no message: only a folder has it, which is made at the end.
    told = {key: told[key] for key in (*TOLD, "seed") if told.get(key)}
    perturb = Perturbation.model_validate(told) if any(key in told for key in TOLD) else None
    before = options.replace(prepared_by=None, remap=remap)
    return _WantedVariant(recorded, before, InputOptions(perturb=perturb))


def prepare_by_program(  # noqa: PLR0917 - as `prepare`
    entry: DatasetEntry,
    roles: Sequence[Role],
    options: InputOptions,
    formats: Sequence[DataFormat],
    cache: Path,
    maker: FrameMaker,
    progress: Callable[[float], None],
    *,
    topics: Sequence[str] = (),
) -> Variant:
    """Make the variant of a dataset whose frames a program makes, or find it in the cache.

    Args:
        entry: The dataset, materialised.
        roles: The sensors that the algorithm takes.
        options: The run's input options.
        formats: Formats that the algorithm reads, the preferred first.
        cache: Folder of the variants.
        maker: The program.
        progress: Called with the share done, 0 to 1.
        topics: Topics that the algorithm is given beside its sensors', as they are.

    Raises:
        InputError: The options don't fit the dataset, or the program failed.
        DataError: The recording can't be used.
        SystemFault: The disk refuses.
    """
    wanted = _wanted(roles, options, maker.program)
    form = DataFormat(entry.dataset.spec.recording.format)
    plain = prepare(
        *(entry, wanted.recorded, wanted.before, (form,), cache), _share(progress, 0.0, 0.2), topics=topics
    )
    key = _key(plain.key, maker)
    folder = cache / key[:32]

    def make(aside: Path) -> None:
        with plain.in_use():
            _make(plain, maker, key, aside, progress)

    make_once(folder, make, _is_sound)
    made, names = _made(entry, folder)
    after = wanted.after.replace(remap=names)
    variant = prepare(*(made, roles, after, formats, cache), _share(progress, 0.9, 1.0), topics=topics)
    return replace(
        variant,
        source_sha256=plain.source_sha256,
        resolution=plain.resolution,
        recorded_frame_rate=plain.recorded_frame_rate,
        recorded_seconds=plain.recorded_seconds,
    )


def show_for_program(  # noqa: PLR0917 - as `prepare_by_program`
    entry: DatasetEntry,
    roles: Sequence[Role],
    options: InputOptions,
    cache: Path,
    program: PreparingProgram,
    folder: Path,
    progress: Callable[[float], None],
    *,
    topics: Sequence[str] = (),
) -> None:
    """Lay out what a program is given, where `prepare_by_program` follows in another process.

    Raises:
        InputError: The options don't fit the dataset.
        DataError: The recording can't be used.
        SystemFault: The disk refuses.
    """
    wanted = _wanted(roles, options, program)
    form = DataFormat(entry.dataset.spec.recording.format)
    plain = prepare(
        *(entry, wanted.recorded, wanted.before, (form,), cache), _share(progress, 0.0, 0.5), topics=topics
    )
    with plain.in_use():
        show_frames(plain, shown_frames(plain), folder, _share(progress, 0.5, 1.0))


def folder_by_program(  # noqa: PLR0917 - as `prepare_by_program`
    entry: DatasetEntry,
    roles: Sequence[Role],
    options: InputOptions,
    formats: Sequence[DataFormat],
    cache: Path,
    maker: FrameMaker,
    *,
    topics: Sequence[str] = (),
) -> Path:
    """Return the folder of a variant that a program makes; until it has, of what is made of its frames.

    Raises:
        InputError: The options don't fit the dataset.
        DataError: The recording can't be read.
    """
    wanted = _wanted(roles, options, maker.program)
    form = DataFormat(entry.dataset.spec.recording.format)
    plain = variant_key(entry, wanted.recorded, wanted.before, (form,), cache, topics=topics)
    folder = cache / _key(plain, maker)[:32]
    if not _is_sound(folder):
        return folder
    made, names = _made(entry, folder)
    after = wanted.after.replace(remap=names)
    return variant_folder(made, roles, after, formats, cache, topics=topics)


def _key(plain: str, maker: FrameMaker) -> str:
    spec = maker.program.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    spec = {name: spec[name] for name in ("gives", "command") if name in spec}
    return digest({"version": _VERSION, "of": plain, "program": maker.digest, "spec": spec})


def _make(
    plain: Variant, maker: FrameMaker, key: str, aside: Path, progress: Callable[[float], None]
) -> None:
    work = maker.work(key)
    try:
        _make_in(work, plain, maker, aside, progress)
    except BaseException as error:
        maker.close(work, keep_log=isinstance(error, InputError))
        raise
    maker.close(work)


def _make_in(
    work: Path, plain: Variant, maker: FrameMaker, aside: Path, progress: Callable[[float], None]
) -> None:
    given, shown = work / "in", shown_frames(plain)
    if not given.exists():  # in a pod, they are shown before the program starts
        given.mkdir()
        show_frames(plain, shown, given, _share(progress, 0.2, 0.4))
    out = maker.run(work, sum(one.count for one in shown.values()), _share(progress, 0.4, 0.8))
    name = FILE_NAMES[plain.format]
    gives = maker.program.given
    try:
        sensors = take_frames(plain, shown, gives, out, aside / name, _share(progress, 0.8, 0.9))
    except DataError as error:
        raise maker.failure(str(error), work) from None
    description = {
        "format": plain.format,
        "recording": name,
        "state": recording_state(aside / name),
        "sensors": {role: view.as_json() for role, view in sensors.items()},
        "program": maker.name,
    }
    (aside / _DESCRIPTION).write_text(json.dumps(description, indent=2) + "\n", encoding="utf-8")


def _is_sound(folder: Path) -> bool:
    with suppress(OSError, ValueError, KeyError):
        known = json.loads((folder / _DESCRIPTION).read_text(encoding="utf-8"))
        return bool(recording_state(folder / known["recording"]) == known["state"])
    return False


def _made(entry: DatasetEntry, folder: Path) -> tuple[DatasetEntry, dict[str, str]]:
    """Return the data that a program made as a dataset of its own, and the names of its sensors by role."""
    known = json.loads((folder / _DESCRIPTION).read_text(encoding="utf-8"))
    views = {role: SensorView.model_validate(view) for role, view in known["sensors"].items()}
    sensors: dict[str, Any] = {view.name: view.as_json() for view in views.values()}
    for sensor in sensors.values():
        del sensor["name"]
    spec = {
        "recording": {"format": known["format"], "files": [{"path": known["recording"]}]},
        "sensors": sensors,
        "gravityAligned": entry.dataset.spec.has_level_truth,
    }
    made = Dataset.model_validate({"metadata": {"name": entry.name}, "spec": spec})
    return DatasetEntry(made, folder), {role: view.name for role, view in views.items()}


def _share(progress: Callable[[float], None], low: float, high: float) -> Callable[[float], None]:
    return lambda share: progress(low + (high - low) * min(share, 1.0))
