# SPDX-License-Identifier: Apache-2.0
"""MLflow: a database ``mlflow.db`` with an experiment a sweep, which ``mlflow ui`` opens."""

from __future__ import annotations

import logging
import os
import posixpath
import re
from typing import TYPE_CHECKING, Any

from slamhive.bridges.gathering import FittedNames
from slamhive.model.extras import library

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.bridges.gathering import Handed
    from slamhive.bridges.places import Here

DATABASE = "mlflow.db"
NEXT = "mlflow ui --backend-store-uri sqlite:///{folder}/mlflow.db"
_UID, _DIGEST = "slamhive.uid", "slamhive.digest"
_MOST_TEXT = 6000
_LONGEST_NAME = 249  # of 250: one may be put before it
_MOST_PARAMETERS, _MOST_TAGS, _MOST_METRICS = 100, 100, 1000


def _batches(items: list[Any], most: int) -> list[list[Any]]:
    return [items[begin : begin + most] for begin in range(0, len(items), most)]


def fit(name: str) -> str:
    """Return a name as MLflow takes it: of its letters, and no path that would lead elsewhere."""
    found = re.sub(r"[^/\w.\- :]", "_", name)[:_LONGEST_NAME]
    if posixpath.normpath(found) != found or found.startswith(("/", "../")):
        found = found.replace("/", "_")
    return f"_{found}" if found in {"", "."} or found.startswith("..") else found


class Writer:
    """Writes runs into one database; those that are there as they are now stay.

    Args:
        folder: where the database is.

    Attributes:
        names: those of settings, figures and tags that MLflow refuses.
    """

    def __init__(self, folder: Path, _source: Here) -> None:
        os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
        library("alembic", "mlflow", "--to mlflow")
        tracking = library("mlflow.tracking", "mlflow", "--to mlflow")
        self._entities = library("mlflow.entities", "mlflow", "--to mlflow")
        logging.getLogger("mlflow").setLevel(logging.WARNING)
        logging.getLogger("alembic").setLevel(logging.WARNING)
        folder.mkdir(parents=True, exist_ok=True)
        self._artifacts = folder.absolute() / "artifacts"
        self._client = tracking.MlflowClient(tracking_uri=f"sqlite:///{folder.absolute() / DATABASE}")
        self.names = FittedNames(fit)
        self._experiments: dict[str, str] = {}
        self._known: dict[str, dict[str, tuple[str, str]]] = {}

    def write(self, run: Handed) -> bool:
        """Write a run; tell whether anything was new."""
        experiment = self._experiment(run.sweep)
        digest = run.digest()
        there = self._known[experiment].get(run.uid)
        if there is not None:
            if there[1] == digest:
                return False
            self._client.delete_run(there[0])
        run = self.names.fitted(run)
        made = self._client.create_run(
            experiment,
            start_time=round(run.began * 1000),
            run_name=run.name,
            tags={_UID: run.uid, "mlflow.source.name": "slamhive"},
        )
        number = made.info.run_id
        tags = [self._entities.RunTag(name, value[:_MOST_TEXT]) for name, value in run.tags.items()]
        if "note" in run.tags:  # where its pages show one
            tags.append(self._entities.RunTag("mlflow.note.content", run.tags["note"]))
        for some in _batches(tags, _MOST_TAGS):
            self._client.log_batch(number, tags=some)
        settings = [
            self._entities.Param(name, str(value)[:_MOST_TEXT]) for name, value in run.settings.items()
        ]
        for some in _batches(settings, _MOST_PARAMETERS):
            self._client.log_batch(number, params=some)
        for some in _batches(self._metrics(run), _MOST_METRICS):
            self._client.log_batch(number, metrics=some)
        if run.files:
            self._client.set_tag(number, "files", "\n".join(run.files)[:_MOST_TEXT])
        state = "FAILED" if run.failed else "FINISHED"
        self._client.set_terminated(number, state, round((run.finished or run.began) * 1000))
        # Last: a run that was half written has no digest, and is written anew.
        self._client.set_tag(number, _DIGEST, digest)
        self._known[experiment][run.uid] = (number, digest)
        return True

    def close(self) -> None:
        """Nothing is open between two runs."""

    def _metrics(self, run: Handed) -> list[Any]:
        metric = self._entities.Metric
        end = round((run.finished or run.began) * 1000)
        found = [metric(name, value, end, 0) for name, value in run.figures.items()]
        for number, t in enumerate(run.series.get("t", ())):
            moment, step = round((run.began + t) * 1000), round(t * 1000)
            found += [
                metric("series/cpu_cores", run.series["cpu"][number], moment, step),
                metric("series/memory_bytes", run.series["memory"][number], moment, step),
            ]
        return found

    def _experiment(self, sweep: str) -> str:
        """Return a sweep's experiment, made where it isn't there, and learn its runs."""
        if sweep not in self._experiments:
            there = self._client.get_experiment_by_name(sweep)
            if there is None:
                number = self._client.create_experiment(sweep, artifact_location=self._artifacts.as_uri())
            else:
                number = there.experiment_id
            self._experiments[sweep] = number
            self._known[number] = dict(self._runs(number))
        return self._experiments[sweep]

    def _runs(self, experiment: str) -> list[tuple[str, tuple[str, str]]]:
        found: list[tuple[str, tuple[str, str]]] = []
        token = None
        while True:
            page = self._client.search_runs([experiment], max_results=1000, page_token=token)
            for one in page:
                tags = one.data.tags
                if _UID in tags:
                    found.append((tags[_UID], (one.info.run_id, tags.get(_DIGEST, ""))))
            token = page.token
            if not token:
                return found
