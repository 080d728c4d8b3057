# SPDX-License-Identifier: Apache-2.0
"""What is still known of what lies on the volumes: by the API, by the archive, or as a test says.

Whoever asks removes what is not known, so an answer is whole or an error.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError

from slamhive.archive import Archive
from slamhive.model.base import GROUP, VERSION
from slamhive.model.errors import InputError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

CHUNK = 500
FILES = "slamhive.io/files"
"""Annotation of runs whose Sweep keeps no files: ``Delete``."""
_TRIES = 3
_TIMEOUT_SECONDS = 60
_FORBIDDEN, _EXPIRED = 403, 410


@dataclass(frozen=True)
class Known:
    """Names of what is in use.

    Attributes:
        runs: UIDs of MappingRuns.
        datasets: names of Datasets.
        variants: folders below variants/ that Datasets name.
        assets: checksums that Algorithms name; None when that can't be found out.
    """

    runs: frozenset[str]
    datasets: frozenset[str]
    variants: frozenset[str]
    assets: frozenset[str] | None


class Lister(Protocol):
    """Lists all objects of a kind, by its plural, completely."""

    def __call__(self, plural: str) -> Iterable[Mapping[str, Any]]:
        """Return the objects.

        Raises:
            PermissionError: it is not allowed to.
            SystemFault: the list is not complete.
        """


def known_to(listing: Lister) -> Known:
    """Return what the objects of a namespace know of.

    Raises:
        SystemFault: a list is not complete.
    """
    try:
        algorithms = [item.get("spec") or {} for item in listing("algorithms")]
        assets = {asset.get("sha256") for spec in algorithms for asset in spec.get("assets") or ()}
    except PermissionError:
        assets = None
    try:
        datasets = list(listing("datasets"))
        runs = frozenset(uid for item in listing("mappingruns") for uid in _run_folders(item))
    except PermissionError as error:
        raise SystemFault(str(error)) from None
    variants = [entry for item in datasets for entry in (item.get("status") or {}).get("variants") or ()]
    return Known(
        runs=runs,
        datasets=frozenset(str(item["metadata"]["name"]) for item in datasets),
        variants=frozenset(name for entry in variants for name in _folders(entry)),
        assets=None if assets is None else frozenset(str(checksum) for checksum in assets if checksum),
    )


def _run_folders(run: Mapping[str, Any]) -> set[str]:
    """Return the names of the folders that a MappingRun needs: its own, and the one whose result it took."""
    status = run.get("status") or {}
    if (run["metadata"].get("annotations") or {}).get(FILES) == "Delete" and _is_settled(run):
        return set()
    _, _, rest = str(status.get("folder") or "").partition("runs/")
    return {str(run["metadata"]["uid"]), rest.partition("/")[0]} - {""}


def _is_settled(run: Mapping[str, Any]) -> bool:
    """Tell whether a run has ended and was measured, if it can be."""
    status = run.get("status") or {}
    measured = bool(status.get("results")) or any(
        item.get("type") == "Evaluated" for item in status.get("conditions") or ()
    )
    wanted = (run.get("spec") or {}).get("evaluate", True) and status.get("trajectory")
    succeeded = status.get("phase") == "Succeeded" and (measured or not wanted)
    return succeeded or status.get("phase") in {"Failed", "Cancelled"}


def _folders(entry: Mapping[str, Any]) -> list[str]:
    """Return the folder names in an entry of a Dataset's status, however they are written."""
    described = entry.get("description") or {}
    paths = [entry.get("folder"), described.get("folder")]
    return [str(path).rstrip("/").rpartition("/")[2] for path in paths if path]


def api_lister(namespace: str, kubeconfig: str | None = None) -> Lister:
    """Return what lists the objects of a namespace.

    Args:
        namespace: the namespace.
        kubeconfig: a file that says how to reach the API; None inside a pod.

    Raises:
        SystemFault: nothing says how to reach it.
    """
    from kubernetes import client, config  # noqa: PLC0415 - takes a second and is for the collector alone

    try:
        if kubeconfig:
            config.load_kube_config(kubeconfig)  # type: ignore[no-untyped-call]
        else:
            config.load_incluster_config()  # type: ignore[no-untyped-call]
    except config.ConfigException as error:
        raise SystemFault(f"the API can't be reached: {error}") from None
    api = client.CustomObjectsApi()

    def page(plural: str, token: str | None) -> dict[str, Any]:
        try:
            answer: Any = api.list_namespaced_custom_object(
                *(GROUP, VERSION, namespace, plural),
                limit=CHUNK,
                _continue=token,
                _request_timeout=_TIMEOUT_SECONDS,
            )
        except client.ApiException as error:
            if error.status == _EXPIRED:
                raise TimeoutError from None
            if error.status == _FORBIDDEN:
                raise PermissionError(
                    f"{plural} of {namespace} can't be listed: the account is not allowed to"
                ) from None
            raise SystemFault(
                f"{plural} of {namespace} can't be listed: {error.status} {error.reason}"
            ) from None
        except Exception as error:
            raise SystemFault(f"{plural} of {namespace} can't be listed: {error}") from error
        return dict(answer)

    return lambda plural: all_pages(lambda token: page(plural, token), plural)


def all_pages(page: Callable[[str | None], Mapping[str, Any]], plural: str) -> list[Mapping[str, Any]]:
    """Return the items of all pages of one list.

    Args:
        page: returns a page by its token; raises TimeoutError when the token is too old.
        plural: what is listed, for the message.

    Raises:
        SystemFault: the list was never seen whole.
    """
    for _ in range(_TRIES):
        items: list[Mapping[str, Any]] = []
        token = None
        try:
            while True:
                answer = page(token)
                found = answer.get("items")
                if not isinstance(found, list):
                    raise SystemFault(f"{plural}: the answer of the API is no list")
                items += found
                token = (answer.get("metadata") or {}).get("continue")
                if not token:
                    return items
        except TimeoutError:
            continue
    raise SystemFault(f"{plural}: the list grew too old {_TRIES} times before it was read to its end")


def known_by_file(path: Path) -> Known:
    """Read what is known from a JSON file with the names of `Known`.

    Raises:
        InputError: it isn't there or is something else.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        sets = {name: frozenset(map(str, found[name])) for name in ("runs", "datasets", "variants")}
        assets = found["assets"]
        return Known(**sets, assets=None if assets is None else frozenset(map(str, assets)))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: can't be used: {error}") from None


def archived(url: str, uids: Iterable[str]) -> frozenset[str]:
    """Return which runs an archive knows together with their folders.

    Args:
        url: of the archive's database.
        uids: the runs asked for.

    Raises:
        InputError: the URL can't be used, or there is no database.
        SystemFault: the database doesn't answer, or knows no run at all: then it is hardly the right one.
    """
    _require_file(url)
    found: set[str] = set()
    with Archive.open(url) as archive:
        if archive.count() == 0:
            raise SystemFault(f"archive {archive.location}: holds no run at all, so no run folder is removed")
        iterator = iter(uids)
        while batch := list(islice(iterator, CHUNK)):
            # A record without a folder is one whose files were not to be kept.
            found.update(record.uid for record in archive.runs({"uid": batch}) if record.folder)
    return frozenset(found)


def _require_file(url: str) -> None:
    """Check that an SQLite archive is there: opening it would make an empty one."""
    try:
        parsed = make_url(url)
    except ArgumentError:
        return  # told when it is opened
    if parsed.get_backend_name() == "sqlite" and not Path(parsed.database or "").is_file():
        raise InputError(f"archive {parsed.database}: does not exist")
