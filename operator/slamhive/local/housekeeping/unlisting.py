# SPDX-License-Identifier: Apache-2.0
"""Removal of datasets and algorithms from a home's catalog, and new names for datasets.

Records of runs stay: they hold all that tables need. A renamed dataset is the same dataset: its records get
the new name and keep their identity, as what a dataset is says its content.
"""

from __future__ import annotations

import json
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import yaml

from slamhive.data.files.once import remove_free
from slamhive.data.store.datasets import MANIFEST, made_folder
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.removed import remove, write_whole
from slamhive.local.housekeeping.collecting import MADE, REMOVING
from slamhive.model.base import require_name
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError, SlamHiveError, SystemFault, UnknownNameError
from slamhive.model.loading import load_file
from slamhive.plan import content_hash, spec_hash

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from slamhive.archive import Archive
    from slamhive.local.home.folder import Home
    from slamhive.model.results import RunRecord

JOURNAL = ".renaming.json"


@dataclass(frozen=True)
class Listed:
    """An entry that was added to a home.

    Attributes:
        name: its name.
        folder: in the home; a link, where it is kept elsewhere.
        made: folders of what was generated or fetched of it.
        comes_back: whether one of that name comes with slamhive, and is known when this one is gone.
    """

    name: str
    folder: Path
    made: tuple[Path, ...] = ()
    comes_back: bool = False


def listed_dataset(home: Home, name: str) -> Listed:
    """Return a dataset that was added to a home, even one whose manifest can't be read.

    Raises:
        UnknownNameError: there is none of that name.
        InputError: it comes with slamhive.
    """
    root = home.path / "datasets"
    folders = {_name_of(folder): folder for folder in _entries(root) if (folder / MANIFEST).exists()}
    bundled = load_workshop().dataset_places.get(name)
    if name not in folders and bundled is not None:
        raise InputError(
            f"dataset {name!r} comes with slamhive and stays; what was generated of it goes by "
            "slamhive gc --all"
        )
    if name not in folders:
        raise UnknownNameError("dataset", name, folders, str(root))
    own = made_folder(bundled.dataset, root) if bundled is not None else None
    made = tuple(
        folder
        for folder in _entries(root)
        if (match := MADE.fullmatch(folder.name))
        and match["name"] == name
        and not (folder / MANIFEST).exists()
        and folder != own
    )
    return Listed(name, folders[name], made, comes_back=bundled is not None)


def listed_algorithm(home: Home, name: str) -> Listed:
    """Return an algorithm that was added to a home.

    Raises:
        UnknownNameError: there is none of that name.
        InputError: it comes with slamhive.
    """
    root = home.path / "algorithms"
    folders = {entry.name: entry for entry in _entries(root)}
    comes_back = name in load_workshop().algorithm_entries
    if name not in folders and comes_back:
        raise InputError(f"algorithm {name!r} comes with slamhive and stays")
    if name not in folders:
        raise UnknownNameError("algorithm", name, folders, str(root))
    return Listed(name, folders[name], comes_back=comes_back)


def unlist(entry: Listed) -> list[Path]:
    """Remove an entry from a home, and return the folders that stay as somebody works with them.

    Raises:
        SystemFault: the disk refuses.
    """
    try:
        busy = [folder for folder in entry.made if not remove_free(folder)]
        if entry.folder.is_symlink():
            entry.folder.unlink()
        else:
            # Aside first, so that no half of it is ever known by its name.
            aside = entry.folder.with_name(f".{entry.folder.name}{REMOVING}")
            remove(aside)
            entry.folder.rename(aside)
            remove(aside)
    except OSError as error:
        raise SystemFault(f"{entry.folder}: {error.strerror or error}") from error
    return busy


@contextmanager
def replaced(home: Home, name: str) -> Iterator[None]:
    """Set the dataset of a name aside while another one takes its place; it is back if that fails.

    Does nothing where none of that name was added.

    Args:
        home: the home, in which the caller is alone.
        name: of the dataset.

    Raises:
        SystemFault: the disk refuses.
    """
    folder = home.path / "datasets" / name
    aside = folder.with_name(f".{name}{REMOVING}")
    if not folder.is_symlink() and not folder.exists():
        yield
        return
    try:
        remove(aside)
        folder.rename(aside)
    except OSError as error:
        raise SystemFault(f"{folder}: {error.strerror or error}") from error
    try:
        yield
    except BaseException:
        remove(folder)
        aside.rename(folder)
        raise
    remove(aside)


def rename_dataset(
    home: Home, archive: Archive, old: str, new: str, step: Callable[[int], None] = lambda _: None
) -> int:
    """Give a dataset of a home another name, in its manifest and in the records of its runs.

    One that is interrupted is gone on with by the same call; another one is refused until then.

    Args:
        home: the home, in which the caller is alone.
        archive: its archive.
        old: the name so far.
        new: the name from now on.
        step: called with the number of records done so far.

    Returns:
        How many records have it now.

    Raises:
        InputError: the name is taken, or no name.
        SystemFault: the disk refuses.
    """
    journal = home.path / JOURNAL
    if not _goes_on(journal, old, new):
        require_free(home, archive, new)
        listed_dataset(home, old)
        write_whole(journal, json.dumps({"dataset": old, "to": new}))
    count = _rename_records(archive, old, new, step)
    root = home.path / "datasets"
    with suppress(UnknownNameError):  # the manifest was renamed before an interruption
        entry = listed_dataset(home, old)
        for made in entry.made:
            made.rename(made.with_name(f"{new}-{made.name.rpartition('-')[2]}"))
        folder = root / new
        if entry.folder != folder:
            entry.folder.rename(folder)
        write_whole(folder / MANIFEST, _renamed_manifest(folder / MANIFEST, new))
    journal.unlink()
    return count


def require_free(home: Home, archive: Archive, new: str) -> None:
    """Refuse a name for a dataset that anything has already, so that no two are ever taken for one.

    Raises:
        InputError: it is taken, or no name.
    """
    require_name(new, "NEW")
    if new in load_workshop(home).dataset_places or (home.path / "datasets" / new).exists():
        raise InputError(f"dataset {new!r} is known already: choose another name")
    count = archive.count({"dataset": new})
    if count:
        runs = "a record refers" if count == 1 else f"{count} records refer"
        raise InputError(
            f"{runs} to a dataset {new!r}, which would be taken for this one: choose another name"
        )


def _goes_on(journal: Path, old: str, new: str) -> bool:
    """Tell whether this very renaming was interrupted before.

    Raises:
        InputError: another one was.
    """
    try:
        begun = json.loads(journal.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return False
    except (OSError, ValueError) as error:
        raise InputError(f"{journal}: can't be read: {error}") from None
    if begun == {"dataset": old, "to": new}:
        return True
    raise InputError(
        f"another dataset's renaming was interrupted; finish it first: slamhive dataset rename "
        f"{begun.get('dataset')} {begun.get('to')}"
    )


def _rename_records(archive: Archive, old: str, new: str, step: Callable[[int], None]) -> int:
    done = 0

    def renamed() -> Iterator[RunRecord]:
        nonlocal done
        for record in archive.runs({"dataset": old}):
            # A cluster's dataset of the same name is another one; of an import nobody knows which it is.
            if record.namespace is None and record.cluster is None and record.provenance.dataset_sha256:
                yield _renamed(record, new)
                done += 1
                step(done)

    archive.rewrite_runs(renamed())
    archive.rename_dataset(old, new)
    return archive.count({"dataset": new})


def _renamed(record: RunRecord, new: str) -> RunRecord:
    """Return a record with another name of its dataset, and the hashes that follow from that."""
    spec: dict[str, Any] = record.spec | {"datasetRef": record.spec["datasetRef"] | {"name": new}}
    known = record.provenance
    parts = (known.algorithm_hash, known.dataset_sha256, known.preparation, known.environment)
    provenance = known
    # One of an earlier slamhive may have been hashed otherwise: it keeps its hashes, and serves no other run.
    if known.spec_hash == spec_hash(record.spec) and None not in parts:
        hash_of = partial(_content_hash, parts=[*map(str, parts)], prepared_by=known.prepared_by)
        hashed = spec_hash(spec)
        if known.content_hash == hash_of(known.spec_hash):
            provenance = known.replace(spec_hash=hashed, content_hash=hash_of(hashed))
    return record.replace(spec=spec, provenance=provenance)


def _content_hash(spec_hash: str, parts: Sequence[str], prepared_by: str | None) -> str:
    algorithm, dataset, preparation, environment = parts
    return content_hash(spec_hash, algorithm, dataset, preparation, environment, prepared_by)


def _renamed_manifest(manifest: Path, new: str) -> str:
    found = [item for item in load_file(manifest) if isinstance(item, Dataset)]
    if len(found) != 1:
        raise InputError(f"{manifest}: {len(found)} Datasets in it, expected one")
    dataset = found[0].replace(metadata=found[0].metadata.replace(name=new))
    return yaml.safe_dump(dataset.as_json(), sort_keys=False, allow_unicode=True)


def _name_of(folder: Path) -> str:
    """Return the name of the dataset in a folder: its manifest's, or else the folder's."""
    with suppress(SlamHiveError, OSError):
        for item in load_file(folder / MANIFEST):
            if isinstance(item, Dataset):
                return item.name
    return folder.name


def _entries(root: Path) -> list[Path]:
    return sorted(path for path in root.glob("*") if not path.name.startswith("."))
