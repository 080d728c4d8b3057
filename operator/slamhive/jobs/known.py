# SPDX-License-Identifier: Apache-2.0
"""Names of everything on the volumes that is still referenced.

The API (asking.py) and the archive say so; in tests, a file. The collector deletes the rest.

A partial list would delete what is in use: so an answer is whole or an error.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.archive import Archive
from slamhive.contract.settled import FILES, is_settled
from slamhive.model.errors import InputError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

_CHUNK = 500


@dataclass(frozen=True)
class NamesInUse:
    """Names of what is in use.

    Attributes:
        runs: UIDs of MappingRuns.
        datasets: names of Datasets.
        variants: folders below variants/ that Datasets name.
        assets: checksums that Algorithms name; None when that can't be found out.
        released: UIDs of runs whose files were not to be kept.
        namespace_uid: uid of the namespace; None where nobody said.
    """

    runs: frozenset[str]
    datasets: frozenset[str]
    variants: frozenset[str]
    assets: frozenset[str] | None
    released: frozenset[str] = frozenset()
    namespace_uid: str | None = None


class Archived(NamedTuple):
    """Identity of an archive, and UIDs of the runs that it knows: with a folder, or released.

    Attributes:
        identity: what tells it from every other archive.
        kept: runs that it knows together with their folders.
        released: runs whose files were not to be kept.
    """

    identity: str
    kept: frozenset[str]
    released: frozenset[str]


def known_to(
    algorithms: Iterable[Mapping[str, Any]] | None,
    datasets: Iterable[Mapping[str, Any]],
    mapping_runs: Iterable[Mapping[str, Any]],
) -> NamesInUse:
    """Return all that the objects of a namespace refer to.

    Args:
        algorithms: all Algorithms; None where they may not be listed.
        datasets: all Datasets.
        mapping_runs: all MappingRuns.
    """
    assets = None
    if algorithms is not None:
        specs = [item.get("spec") or {} for item in algorithms]
        found = {asset.get("sha256") for spec in specs for asset in spec.get("assets") or ()}
        assets = frozenset(str(checksum) for checksum in found if checksum)
    datasets = list(datasets)
    runs = {str(item["metadata"]["uid"]): _run_folders(item) for item in mapping_runs}
    variants = [entry for item in datasets for entry in (item.get("status") or {}).get("variants") or ()]
    return NamesInUse(
        runs=frozenset(uid for folders in runs.values() for uid in folders),
        released=frozenset(uid for uid, folders in runs.items() if not folders),
        datasets=frozenset(str(item["metadata"]["name"]) for item in datasets),
        variants=frozenset(name for entry in variants for name in _folders(entry)),
        assets=assets,
    )


def _run_folders(run: Mapping[str, Any]) -> set[str]:
    """Return the names of the folders that a MappingRun needs: its own, and the one whose result it took."""
    status = run.get("status") or {}
    if (run["metadata"].get("annotations") or {}).get(FILES) == "Delete" and is_settled(run):
        return set()
    _, _, rest = str(status.get("folder") or "").partition("runs/")
    return {str(run["metadata"]["uid"]), rest.partition("/")[0]} - {""}


def _folders(entry: Mapping[str, Any]) -> list[str]:
    """Return the folder names in an entry of a Dataset's status, however they are written."""
    described = entry.get("description") or {}
    paths = [entry.get("folder"), described.get("folder")]
    return [str(path).rstrip("/").rpartition("/")[2] for path in paths if path]


def known_by_file(path: Path) -> NamesInUse:
    """Read what is known from a JSON file with the names of `NamesInUse`.

    Raises:
        InputError: it isn't there or is something else.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        sets = {name: frozenset(map(str, found[name])) for name in ("runs", "datasets", "variants")}
        assets = found["assets"]
        return NamesInUse(
            **sets,
            assets=None if assets is None else frozenset(map(str, assets)),
            released=frozenset(map(str, found.get("released", ()))),
            namespace_uid=found.get("namespaceUid"),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: can't be used: {error}") from None


def archived(url: str, uids: Iterable[str]) -> Archived:
    """Return the runs that an archive knows.

    Args:
        url: of the archive's database.
        uids: the runs asked for.

    Raises:
        InputError: the URL can't be used, or there is no archive.
        SystemFault: the database doesn't answer, or knows no run at all: then it is hardly the right one.
    """
    kept: set[str] = set()
    released: set[str] = set()
    iterator = iter(uids)
    with Archive.open(url, read_only=True) as archive:
        while batch := list(islice(iterator, _CHUNK)):
            if archive.count() == 0:
                raise SystemFault(
                    f"archive {archive.location}: holds no run at all, so no run folder is removed"
                )
            for record in archive.runs({"uid": batch}):
                # A record without a folder is one whose files were not to be kept.
                (kept if record.folder else released).add(record.uid)
        return Archived(archive.identity, frozenset(kept), frozenset(released))
