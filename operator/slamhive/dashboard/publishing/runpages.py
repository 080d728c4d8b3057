# SPDX-License-Identifier: Apache-2.0
"""Pages of runs on a site: what each shows, with its path and its load, some runs in a file.

A run that a site had before stays where it is, whether or not the source has it still: its address stays.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.dashboard.answering.encoding import Body, encode_json
from slamhive.dashboard.answers import one_run
from slamhive.dashboard.answers.columns import rounded
from slamhive.dashboard.problems import told
from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.archive.records import CatalogEntry
    from slamhive.dashboard.publishing.asking import PublishedRuns
    from slamhive.dashboard.publishing.folder import SiteFolder
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.model.results import RunRecord

TOGETHER = 50
"""Runs in a file."""

ALONE = 16_000
"""Bytes from which a path or load has a file of its own."""

EXACT = 1000
"""Runs up to which paths have every digit; of more they have 6, as points have."""

POINTS = (50, 2000)
"""Poses of a path, at least and at most: as the page of a run asks for, and as fit of many runs."""

_POSES = 300_000
"""Poses of all paths together, of which each takes some 30 bytes."""

_DIGITS = 6
_SHORT = 12
_AHEAD = 200


class RunPages:
    """Writes what the pages of runs show.

    Args:
        folder: the site's.
        source: where the runs are.
        snapshot: its data.
        count: of runs there are.
    """

    def __init__(self, folder: SiteFolder, source: PublishedRuns, snapshot: Snapshot, count: int) -> None:
        self._folder = folder
        self._source: Any = source
        self._snapshot = snapshot
        self._alike = one_run.RunsAlike()
        self._algorithms: list[CatalogEntry] = self._source.catalog("Algorithm")
        self._truths: dict[tuple[str, str | None], Any] = {}
        self._exact = count <= EXACT
        least, most = POINTS
        self._points = most if self._exact else max(least, min(most, _POSES // max(1, count)))

    def written(self, uids: Sequence[str], before: dict[str, Any] | None) -> dict[str, Any]:
        """Write runs, and return which file has which.

        Args:
            uids: of the runs.
            before: what this returned for the site as it was.
        """
        places: dict[str, tuple[str, str]] = {}
        if before:
            files, at, marks = before["files"], before["at"], before["marks"]
            places = {uid: (files[n], mark) for uid, n, mark in zip(before["uids"], at, marks, strict=True)}
        news: dict[str, Any] = {}
        for at, uid in enumerate(uids):
            if at % _AHEAD == 0:
                self._source.ahead(uids[at : at + _AHEAD])
            page = self._page(uid)
            mark = hashlib.sha256(encode_json(page)).hexdigest()[:_SHORT]
            if places.get(uid, ("", ""))[1] != mark:
                news[uid] = page
                places[uid] = ("", mark)
                if len(news) == TOGETHER:
                    self._keep(news, places)
        self._keep(news, places)
        files = list(dict.fromkeys(file for file, _ in places.values()))
        numbers = {file: number for number, file in enumerate(files)}
        return {
            "uids": list(places),
            "at": [numbers[file] for file, _ in places.values()],
            "marks": [mark for _, mark in places.values()],
            "files": files,
        }

    def _keep(self, news: dict[str, Any], places: dict[str, tuple[str, str]]) -> None:
        if news:
            file = self._folder.keep(news)
            places.update({uid: (file, places[uid][1]) for uid in news})
            news.clear()

    def _page(self, uid: str) -> dict[str, Any]:
        """Return all answers on a run, by the ends of their addresses."""
        seen = one_run.found(self._source, uid)
        page = {"": one_run.detail(self._snapshot, seen, self._alike).content}
        if seen.place is not None:
            names: list[str | None] = [result.evaluation for result in seen.record.results]
            names = names or [None]
            paths = {name or "": self._asked(self._path(seen, name)) for name in names}
            page["trajectory"] = paths
            page["usage"] = self._asked(lambda: one_run.usage(self._snapshot, seen, self._points))
        return page

    def _path(self, seen: one_run.FoundRun, evaluation: str | None) -> Callable[[], Body]:
        def made() -> Body:
            record = seen.record
            material = one_run.RunMaterial(record, seen.folder, self._truth(record), self._algorithms)
            return one_run.trajectory(self._snapshot, material, evaluation, self._points)

        return made

    def _truth(self, record: RunRecord) -> Any:
        key = (str((record.spec.get("datasetRef") or {}).get("name")), record.labels.get("dataset"))
        if key not in self._truths:
            self._truths[key] = self._source.truth(*key)
        return self._truths[key]

    def _asked(self, make: Callable[[], Body]) -> Any:
        """Return an answer, or what keeps it from being one; long ones as files of their own."""
        try:
            answer = make().content
        except SlamHiveError as error:
            found = told(error)
            if found is None:
                raise
            return {"refused": found[0], **found[1]}
        if not self._exact:
            answer = _short(answer)
        if answer.get("reference") is not None:  # the same for all runs on a dataset
            answer = answer | {"reference": {"file": self._folder.keep(answer["reference"])}}
        content = encode_json(answer)
        return {"file": self._folder.keep_text(content)} if len(content) > ALONE else answer


def _short(value: Any) -> Any:
    """Return an answer with the digits of its columns that count."""
    if isinstance(value, dict):
        return {name: _short(one) for name, one in value.items() if name != "t"} | (
            {"t": np.round(np.asarray(value["t"], dtype=np.float64), 4)} if "t" in value else {}
        )
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return rounded(value, _DIGITS)
    return value
