# SPDX-License-Identifier: Apache-2.0
"""Opening of a bundle that a stranger made: unpacked within bounds, each file held against its checksum."""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel, ValidationError

from slamhive.archive.records import require_parts
from slamhive.bridges.bundles.contents import FORM, METADATA, RUN, STUDY, BundledRun, BundledStudy
from slamhive.contract.files import read_regular
from slamhive.contract.lines import printable
from slamhive.data.files.unpacking import unpack
from slamhive.data.recordings.entries import file_sha256
from slamhive.model.base import explain
from slamhive.model.errors import DataError, InputError
from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.model.algorithm import Algorithm
    from slamhive.model.dataset import Dataset

_LIMIT_BYTES = 64 << 20
_SHOWN = 5
_RUN_NAME = re.compile(r"[a-z0-9]([-a-z0-9.]{0,61}[a-z0-9])?")
_Checked = TypeVar("_Checked", bound=BaseModel)


@dataclass(frozen=True)
class OpenedBundle:
    """A bundle whose files are what their checksums say.

    Attributes:
        title: the file's name.
        folder: where it is unpacked.
        study: what it is of.
        sha256: of study.json, and by it of all files.
        runs: its runs, by name.
    """

    title: str
    folder: Path
    study: BundledStudy
    sha256: str
    runs: dict[str, BundledRun]

    def file(self, run: str, name: str) -> Path:
        """Return the path of a run's file, there or not."""
        return self.folder / "runs" / run / name

    def manifest(self, name: str) -> Algorithm | Dataset:
        """Return an object of a manifest in the bundle.

        Raises:
            InputError: it doesn't follow the language.
        """
        return load_file(self.folder / name)[0]  # type: ignore[return-value]


@contextmanager
def opened_bundle(path: Path) -> Iterator[OpenedBundle]:
    """Unpack a bundle into a folder of its own, which goes when this ends.

    Raises:
        DataError: it is no bundle, damaged, changed, or larger than an archive of data gets.
        SystemFault: the disk refuses.
    """
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    with tempfile.TemporaryDirectory(prefix="slamhive-bundle-") as name:
        folder = Path(name)
        unpack(path, [""], folder, title=path.name)
        yield _opened(path.name, folder)


def _opened(title: str, folder: Path) -> OpenedBundle:
    if not (folder / STUDY).is_file():
        raise DataError(f"{title}: has no {STUDY}: it is no bundle of slamhive bundle")
    content = _content(folder / STUDY, title, STUDY)
    told = _json(content, title, STUDY)
    if not isinstance(told, dict) or told.get("form") != FORM:
        form = printable(str(told.get("form") if isinstance(told, dict) else told))[:40]
        raise DataError(f"{title}: {STUDY}: form is {form!r}, and this slamhive reads {FORM!r}")
    study = _checked(BundledStudy, told, title, STUDY)
    _require_sums(title, folder, study)
    runs = {}
    for name in sorted(study.files):
        parts = name.split("/")
        if parts[0] == "runs" and parts[-1] == RUN:
            runs[parts[1]] = _run(title, folder, study, name)
    if not runs:
        raise DataError(f"{title}: has no runs")
    found = OpenedBundle(title, folder, study, hashlib.sha256(content).hexdigest(), runs)
    manifests = [one.manifest for one in study.algorithms] + [one.manifest for one in study.datasets]
    for name in manifests:
        try:
            found.manifest(name)
        except InputError as error:
            raise DataError(f"{title}: {str(error).replace(f'{folder}/', '')}") from None
    return found


def _require_sums(title: str, folder: Path, study: BundledStudy) -> None:
    there = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} - {STUDY}
    missing, more = sorted(study.files.keys() - there), sorted(there - study.files.keys())
    if METADATA not in study.files:
        missing.append(METADATA)
    for names, what in ((missing, "lacks"), (more, f"holds what {STUDY} doesn't name:")):
        if names:
            rest = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            raise DataError(f"{title}: {what} {printable(', '.join(names[:_SHOWN]))}{rest}")
    names = sorted(study.files)
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        sums = list(pool.map(lambda name: file_sha256(folder / name), names))
    changed = [name for name, sha256 in zip(names, sums, strict=True) if study.files[name] != sha256]
    if changed:
        rest = f" and {len(changed) - _SHOWN} more" if len(changed) > _SHOWN else ""
        raise DataError(
            f"{title}: {', '.join(changed[:_SHOWN])}{rest}: not what {STUDY} has the checksum of: changed "
            "after the bundle was made"
        )


def _run(title: str, folder: Path, study: BundledStudy, name: str) -> BundledRun:
    run = _checked(BundledRun, _json(_content(folder / name, title, name), title, name), title, name)
    record, folder_name = run.record, name.split("/")[1]
    if record.name != folder_name or not _RUN_NAME.fullmatch(record.name):
        raise DataError(f"{title}: {name}: record.name: expected {folder_name!r}, found {record.name[:80]!r}")
    missing = [part for part in ("algorithmRef", "datasetRef") if not isinstance(record.spec.get(part), dict)]
    if missing:
        raise DataError(f"{title}: {name}: record.spec.{missing[0]}: expected an object with a name")
    try:
        require_parts(record.spec)
    except ValueError as error:
        raise DataError(f"{title}: {name}: record.{error}") from None
    known = {one.manifest for one in study.algorithms}, {one.manifest for one in study.datasets}
    for field, manifest, names in (
        ("algorithm", run.algorithm, known[0]),
        ("dataset", run.dataset, known[1]),
    ):
        if manifest not in names or manifest not in study.files:
            raise DataError(f"{title}: {name}: {field}: {manifest[:120]!r} is none of the study's manifests")
    return run


def _content(path: Path, title: str, name: str) -> bytes:
    content = read_regular(str(path), _LIMIT_BYTES + 1)
    if len(content) > _LIMIT_BYTES:
        raise DataError(f"{title}: {name}: is larger than {_LIMIT_BYTES >> 20} MiB")
    return content


def _json(content: bytes, title: str, name: str) -> Any:
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{title}: {name}: is no JSON: {printable(str(error))[:120]}") from None


def _checked(model: type[_Checked], value: Any, title: str, name: str) -> _Checked:
    try:
        return model.model_validate(value)
    except (ValidationError, RecursionError) as error:
        if isinstance(error, RecursionError):
            raise DataError(f"{title}: {name}: is nested too deeply") from None
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"]))
        found = printable(str(first.get("input")))[:60]
        raise DataError(f"{title}: {name}: {field}: {explain(first)}, found {found!r}") from None
