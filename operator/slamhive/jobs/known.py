# SPDX-License-Identifier: Apache-2.0
"""Names of everything on the volumes that is still referenced.

The API and the archive say so; in tests, a file. The collector deletes the rest.

A partial list would delete what is in use: so an answer is whole or an error.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from slamhive.archive import Archive
from slamhive.contract.settled import FILES, is_settled
from slamhive.model.base import GROUP, VERSION
from slamhive.model.errors import InputError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

CHUNK = 500
_TRIES = 3
_TIMEOUT_SECONDS = 60
_EVENT_LENGTH = 1024
_FORBIDDEN, _EXPIRED = 403, 410


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


class Lister(Protocol):
    """Lists all objects of a kind, by its plural, completely."""

    def __call__(self, plural: str) -> Iterable[Mapping[str, Any]]:
        """Return the objects.

        Raises:
            PermissionError: it is not allowed to.
            SystemFault: the list is not complete.
        """


def known_to(listing: Lister) -> NamesInUse:
    """Return all that the objects of a namespace refer to.

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
        runs = {str(item["metadata"]["uid"]): _run_folders(item) for item in listing("mappingruns")}
    except PermissionError as error:
        raise SystemFault(str(error)) from None
    variants = [entry for item in datasets for entry in (item.get("status") or {}).get("variants") or ()]
    return NamesInUse(
        runs=frozenset(uid for folders in runs.values() for uid in folders),
        released=frozenset(uid for uid, folders in runs.items() if not folders),
        datasets=frozenset(str(item["metadata"]["name"]) for item in datasets),
        variants=frozenset(name for entry in variants for name in _folders(entry)),
        assets=None if assets is None else frozenset(str(checksum) for checksum in assets if checksum),
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


def _api(kubeconfig: str | None) -> Any:
    """Return the module of the Kubernetes client, told how to reach the API.

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
    return client


def known_to_api(namespace: str, kubeconfig: str | None = None) -> NamesInUse:
    """Return all that a namespace and its objects refer to.

    Args:
        namespace: the namespace.
        kubeconfig: a file that says how to reach the API; None inside a pod.

    Raises:
        SystemFault: the API doesn't answer, or not whole.
    """
    client = _api(kubeconfig)
    try:
        body = client.CoreV1Api().read_namespace(namespace, _request_timeout=_TIMEOUT_SECONDS)
    except client.ApiException as error:
        raise SystemFault(f"namespace {namespace} can't be read: {error.status} {error.reason}") from None
    except Exception as error:
        raise SystemFault(f"namespace {namespace} can't be read: {error}") from error
    return replace(known_to(_lister(client, namespace)), namespace_uid=body.metadata.uid)


def tell_cronjob(
    namespace: str, name: str, message: str, kubeconfig: str | None = None, *, reason: str
) -> None:
    """Attach an Event to a CronJob, for who asks why it fails.

    Args:
        namespace: the namespace.
        name: the CronJob.
        message: a sentence.
        reason: what happened, in one word.
        kubeconfig: as for `known_to_api`.

    Raises:
        SystemFault: it can't be.
    """
    client = _api(kubeconfig)
    place = {"apiVersion": "batch/v1", "kind": "CronJob", "name": name, "namespace": namespace}
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    event = {
        "metadata": {"generateName": f"{name}.", "namespace": namespace},
        "type": "Warning",
        "reason": reason,
        "message": message[:_EVENT_LENGTH],
        "source": {"component": name},
        "firstTimestamp": now,
        "lastTimestamp": now,
        "count": 1,
    }
    try:
        job: Any = client.CustomObjectsApi().get_namespaced_custom_object(
            *("batch", "v1", namespace, "cronjobs", name), _request_timeout=_TIMEOUT_SECONDS
        )
        event["involvedObject"] = place | {"uid": job["metadata"]["uid"]}
        client.CoreV1Api().create_namespaced_event(namespace, event, _request_timeout=_TIMEOUT_SECONDS)
    except Exception as error:
        raise SystemFault(f"cronjob {name} can't be told: {' '.join(str(error).split())}") from error


def _lister(client: Any, namespace: str) -> Lister:
    """Return a function that lists the objects of a namespace."""
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
        while batch := list(islice(iterator, CHUNK)):
            if archive.count() == 0:
                raise SystemFault(
                    f"archive {archive.location}: holds no run at all, so no run folder is removed"
                )
            for record in archive.runs({"uid": batch}):
                # A record without a folder is one whose files were not to be kept.
                (kept if record.folder else released).add(record.uid)
        return Archived(archive.identity, frozenset(kept), frozenset(released))
