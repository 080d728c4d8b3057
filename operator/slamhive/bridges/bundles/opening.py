# SPDX-License-Identifier: Apache-2.0
"""Opening of a bundle that a stranger made: read within bounds, each file held against its checksum."""

from __future__ import annotations

import hashlib
import json
import os
import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel, ValidationError

from slamhive.archive.records import require_parts
from slamhive.bridges.bundles.contents import (
    FORM,
    METADATA,
    README,
    RUN,
    STATED,
    STUDY,
    BundledRun,
    BundledStudy,
    study_sha256,
)
from slamhive.bridges.bundles.zipfiles import BundleFile
from slamhive.contract.lines import printable
from slamhive.model.base import explain
from slamhive.model.errors import DataError, InputError
from slamhive.model.loading import parse, to_object

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

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
        file: its file.
        study: what it is of.
        sha256: of study.json, and by it of all files.
        runs: its runs, by name.
    """

    file: BundleFile
    study: BundledStudy
    sha256: str
    runs: dict[str, BundledRun]

    def manifest(self, name: str) -> Algorithm | Dataset:
        """Return an object of a manifest in the bundle.

        Raises:
            DataError: it doesn't follow the language.
        """
        title = self.file.title
        try:
            (document,) = parse(_text(self.file, name), f"{title}: {name}")
            return to_object(document)  # type: ignore[return-value]
        except ValueError:
            raise DataError(f"{title}: {name}: expected one object") from None
        except InputError as error:
            raise DataError(str(error)) from None


@contextmanager
def opened_bundle(path: Path, *, later: Collection[str] = ()) -> Iterator[OpenedBundle]:
    """Open a bundle and check what is in it, as long as this lasts.

    Args:
        path: the file.
        later: names of files of runs whose checksums are left to who reads them, by `require_unchanged`.

    Raises:
        DataError: it is no bundle, damaged, changed, or larger than an archive of data gets.
    """
    if not path.is_file():
        problem = "a folder; a bundle is one .zip file" if path.is_dir() else "no such file"
        raise DataError(f"{path}: {problem}")
    with BundleFile(path) as file:
        yield _opened(file, later)


def require_unchanged(title: str, study: BundledStudy, sums: Mapping[str, str]) -> None:
    """Refuse a bundle of which files were changed after it was made.

    Args:
        title: the bundle's name.
        study: what it should be.
        sums: SHA-256 of files as they are, by their names.

    Raises:
        DataError: naming the first few.
    """
    changed = sorted(name for name, sha256 in sums.items() if study.files[name] != sha256)
    if changed:
        rest = f" and {len(changed) - _SHOWN} more" if len(changed) > _SHOWN else ""
        raise DataError(
            f"{title}: {', '.join(changed[:_SHOWN])}{rest}: not what {STUDY} has the checksum of: changed "
            "after the bundle was made"
        )


def _opened(file: BundleFile, later: Collection[str]) -> OpenedBundle:
    title = file.title
    if STUDY not in file.names:
        raise DataError(f"{title}: has no {STUDY}: it is no bundle of slamhive bundle")
    content = file.read(STUDY, _LIMIT_BYTES)
    told = _json(content, title, STUDY)
    if not isinstance(told, dict) or told.get("form") != FORM:
        form = printable(str(told.get("form") if isinstance(told, dict) else told))[:40]
        raise DataError(f"{title}: {STUDY}: form is {form!r}, and this slamhive reads {FORM!r}")
    study = _checked(BundledStudy, told, title, STUDY)
    _require_names(file, study)
    names = [name for name in study.files if name.rpartition("/")[2] not in later]
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        require_unchanged(title, study, dict(zip(names, pool.map(file.copy, names), strict=True)))
    # Bundles of before state none.
    last = _text(file, README).rstrip().rpartition("\n")[2] if README in study.files else ""
    if last.startswith(STATED) and last != STATED + study_sha256(told):
        raise DataError(
            f"{title}: {STUDY}: not what {README} has the checksum of: changed after the bundle was made"
        )
    runs = {}
    for name in sorted(study.files):
        parts = name.split("/")
        if parts[0] == "runs" and parts[-1] == RUN:
            runs[parts[1]] = _run(file, study, name)
    if not runs:
        raise DataError(f"{title}: has no runs")
    found = OpenedBundle(file, study, hashlib.sha256(content).hexdigest(), runs)
    for name in [*(one.manifest for one in study.algorithms), *(one.manifest for one in study.datasets)]:
        found.manifest(name)
    return found


def _require_names(file: BundleFile, study: BundledStudy) -> None:
    there = file.names - {STUDY}
    missing, more = sorted(study.files.keys() - there), sorted(there - study.files.keys())
    if METADATA not in study.files:
        missing.append(METADATA)
    for names, what in ((missing, "lacks"), (more, f"holds what {STUDY} doesn't name:")):
        if names:
            rest = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            raise DataError(f"{file.title}: {what} {printable(', '.join(names[:_SHOWN]))}{rest}")


def _run(file: BundleFile, study: BundledStudy, name: str) -> BundledRun:
    title = file.title
    run = _checked(BundledRun, _json(file.read(name, _LIMIT_BYTES), title, name), title, name)
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


def _text(file: BundleFile, name: str) -> str:
    try:
        return file.read(name, _LIMIT_BYTES).decode()
    except UnicodeDecodeError:
        raise DataError(f"{file.title}: {name}: not a text file in UTF-8") from None


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
