# SPDX-License-Identifier: Apache-2.0
"""The dashboard's settings in a cluster: one YAML file, written by the chart."""

from __future__ import annotations

from pathlib import Path

import yaml
from pydantic import Field, ValidationError

from slamhive.dashboard.server.serving import CONNECTIONS, CONNECTIONS_PER_ADDRESS
from slamhive.kube.settings import NamespaceName
from slamhive.model.base import Model, Quantity, explain, quantity
from slamhive.model.errors import InputError
from slamhive.runfiles.stored import Shelf
from slamhive.storage.store import ObjectStorage, StoreSettings

_SHARE = 0.8


class DashboardSettings(Model):
    """All settings.

    Attributes:
        namespaces: whose objects are shown.
        archive_url_file: file that holds the archive's database URL.
        cluster_name: shown on the pages.
        results: where the results volume is mounted.
        ground_truth: where ground truth is mounted, DATASET.txt each.
        cache: folder that outlives the process, for a faster start.
        store: settings of the object storage that run folders are moved to; None for none.
        store_secret: folder with further options of it, a file each.
        store_cache: folder for files from there.
        store_cache_limit: what that folder may hold.
        host, port: where to listen.
        health_port: port of /healthz and /readyz alone; None for none.
        connections_per_address: how many one address may have: an ingress is one.
    """

    namespaces: list[NamespaceName] = Field(min_length=1)
    archive_url_file: Path | None = None
    cluster_name: str = ""
    results: Path | None = None
    ground_truth: Path | None = None
    cache: Path | None = None
    store: Path | None = None
    store_secret: Path | None = None
    store_cache: Path = Path("/tmp/store")  # noqa: S108 - of a pod
    store_cache_limit: Quantity = "200Mi"
    host: str = "0.0.0.0"  # noqa: S104 - in a pod, behind a Service
    port: int = Field(default=8000, ge=0, le=65535)
    health_port: int | None = Field(default=None, ge=0, le=65535)
    connections_per_address: int = Field(default=CONNECTIONS_PER_ADDRESS, ge=1, le=CONNECTIONS)

    def shelf(self) -> Shelf | None:
        """Return the object storage, None where none is set.

        Raises:
            InputError: its settings can't be used.
        """
        if self.store is None:
            return None
        store = ObjectStorage(StoreSettings.read(self.store, self.store_secret))
        # A pod whose folder is fuller than it may be is ended: some room is left.
        return Shelf(store, self.store_cache, int(_SHARE * quantity(self.store_cache_limit)))

    def archive_url(self) -> str | None:
        """Return the database URL in the file.

        Raises:
            InputError: it can't be read.
        """
        if self.archive_url_file is None:
            return None
        try:
            url = self.archive_url_file.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            name = type(error).__name__
            raise InputError(f"archiveUrlFile: {self.archive_url_file} cannot be read: {name}") from None
        if not url:
            raise InputError(f"archiveUrlFile: {self.archive_url_file} is empty: expected a database URL")
        return url


def load_settings(path: Path) -> DashboardSettings:
    """Read the settings.

    Raises:
        InputError: a sentence that names the file, the field and what is allowed.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the dashboard's settings cannot be read: {error}") from None
    except yaml.YAMLError as error:
        raise InputError(f"{path}: not valid YAML: {getattr(error, 'problem', error)}") from None
    try:
        return DashboardSettings.model_validate(content if content is not None else {})
    except ValidationError as error:
        lines = []
        for mistake in error.errors():
            field = ".".join(str(part) for part in mistake["loc"]) or "the file"
            told = "unknown setting" if mistake["type"] == "extra_forbidden" else explain(mistake)
            lines.append(f"{path}: {field}: {told}")
        raise InputError("\n".join(lines)) from None
