# SPDX-License-Identifier: Apache-2.0
"""The Job that brings run folders back from object storage, and what tells a pod of that storage."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.kube.builders.common import (
    Manifest,
    claim,
    config_map,
    container,
    equal_resources,
    label,
    mount,
    pod_spec,
    variables,
)
from slamhive.kube.builders.request import ENVIRONMENT, REQUEST, TMP, module, request_job
from slamhive.model.canonical import digest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.kube.settings import Settings, StoreReference

RESTORE = "restore"
FOLDERS = label("folders")
"""Annotation of the Job: what it was asked for, separated by commas."""
STORE = "store"
STORE_SECRET = "store-secret"  # noqa: S105 - the name of a volume

_STORE_FOLDER = "/etc/slamhive-store"
_SECRET_FOLDER = "/etc/slamhive-store-secret"  # noqa: S105
_HASH_LENGTH = 20
_DEADLINE_SECONDS = 6 * 3600


def store_words(store: StoreReference) -> list[str]:
    """Return the options by which a program of ours finds the storage that is mounted."""
    words = ["--store", f"{_STORE_FOLDER}/store.yaml"]
    return words + (["--secret", _SECRET_FOLDER] if store.secret else [])


def store_mounts(store: StoreReference) -> list[Manifest]:
    """Return the mounts of what tells a container of the storage."""
    found = [mount(STORE, _STORE_FOLDER, read_only=True)]
    return found + ([mount(STORE_SECRET, _SECRET_FOLDER, read_only=True)] if store.secret else [])


def store_volumes(store: StoreReference) -> list[Manifest]:
    """Return the volumes of what tells of the storage."""
    secret = {"name": STORE_SECRET, "secret": {"secretName": store.secret, "defaultMode": 0o440}}
    return [config_map(STORE, store.config_map), *([secret] if store.secret else [])]


def restore_job_name(namespace: str, owner: str, folders: Sequence[str]) -> str:
    """Return the name of the Job that brings folders back: the same ones for the same owner have the same."""
    parts = {"namespace": namespace, "owner": owner, "folders": sorted(folders)}
    return f"{RESTORE}-{digest(parts)[:_HASH_LENGTH]}"


def restore_job(
    namespace: str,
    folders: Sequence[str],
    *,
    owner: Manifest,
    store: StoreReference,
    labels: Mapping[str, str],
    settings: Settings,
) -> Manifest:
    """Return the Job that has run folders on the results volume again.

    Args:
        namespace: of the runs.
        folders: the folders, as ``runs/UID/POD``.
        owner: reference to what it goes with.
        store: where they are.
        labels: labels by which its end leads back to who waits for it.
        settings: the operator's.

    Raises:
        InputError: the request doesn't fit into an object.
    """
    body = container(
        RESTORE,
        settings.image,
        settings.image_pull_policy,
        command=module("restore", *store_words(store)),
        env=variables(ENVIRONMENT),
        mounts=[REQUEST, mount("results", "/slamhive/results"), TMP, *store_mounts(store)],
        resources=equal_resources("500m", "512Mi", logs="64Mi"),
    )
    return request_job(
        namespace,
        restore_job_name(namespace, owner["uid"], folders),
        pod_spec(settings),
        role=RESTORE,
        containers=[body],
        claims=[claim("results", settings.volumes.results.claim)],
        deadline_seconds=_DEADLINE_SECONDS,
        request={"folders": list(folders)},
        volumes=store_volumes(store),
        labels=labels,
        owners=[owner],
        notes={FOLDERS: ",".join(folders)},
    )
