# SPDX-License-Identifier: Apache-2.0
"""Pages of runs on a site: what each shows, with its path and its load, some runs in a file.

A run that a site had before stays where it is, whether or not the source has it still: its address stays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.dashboard.answering.encoding import Body, encode_json
from slamhive.dashboard.answers import one_run
from slamhive.dashboard.answers.columns import rounded
from slamhive.dashboard.problems import told
from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

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

MOST_POINTS = 2000
"""Poses of a path up to EXACT runs: as the page of a run asks for."""

POINTS = (200, 100, 50)
"""The same of more runs, the most that fit: few steps, so that a run more leaves the paths of others."""

_POSES = 300_000
"""Poses of all paths together, of which each takes some 30 bytes."""

_DIGITS = 6
_AHEAD = 200


def poses_of(count: int) -> tuple[int, bool]:
    """Return the poses of a path on a site of so many runs, and whether they have every digit."""
    if count <= EXACT:
        return MOST_POINTS, True
    return next((points for points in POINTS if points * count <= _POSES), POINTS[-1]), False


class RunPages:
    """Writes what the pages of runs show.

    Args:
        folder: the site's.
        source: where the runs are.
        snapshot: its data.
        marks: of the runs by UID, that differ where their pages do.
        alike: what their pages have in common.
    """

    def __init__(
        self,
        folder: SiteFolder,
        source: PublishedRuns,
        snapshot: Snapshot,
        marks: Mapping[str, str],
        alike: one_run.RunsAlike,
    ) -> None:
        self._folder = folder
        self._source: Any = source
        self._snapshot = snapshot
        self._marks = marks
        self._alike = alike
        self._algorithms: list[CatalogEntry] = self._source.catalog("Algorithm")
        self._truths: dict[tuple[str, str | None], Any] = {}
        self._points, self._exact = poses_of(len(marks))

    def written(self, before: dict[str, Any] | None, *, lost: bool = False) -> dict[str, Any]:
        """Write the runs whose marks are new, and return which file has which run.

        Args:
            before: what this returned for the site as it was.
            lost: whether files were lost from the site, perhaps ones that pages lead to.
        """
        places: dict[str, tuple[str, str]] = {}
        broken: set[str] = set()
        if before:
            files, at, marks = before["files"], before["at"], before["marks"]
            there = [self._folder.place(name).exists() for name in files]
            rows = zip(before["uids"], at, marks, strict=True)
            places = {uid: (files[n], mark) for uid, n, mark in rows if there[n]}
            broken = {name for name in files if lost and not self._is_whole(name)}
        same = {uid: mark for uid, (file, mark) in places.items() if file not in broken}
        changed = [uid for uid, mark in self._marks.items() if same.get(uid) != mark]
        for start in range(0, len(changed), TOGETHER):
            some = changed[start : start + TOGETHER]
            if start % _AHEAD == 0:
                self._source.ahead(changed[start : start + _AHEAD])
            file = self._folder.keep({uid: self._page(uid) for uid in some})
            places |= {uid: (file, self._marks[uid]) for uid in some}
        files = list(dict.fromkeys(file for file, _ in places.values()))
        numbers = {file: number for number, file in enumerate(files)}
        return {
            "uids": list(places),
            "at": [numbers[file] for file, _ in places.values()],
            "marks": [mark for _, mark in places.values()],
            "files": files,
        }

    def _is_whole(self, name: str) -> bool:
        """Tell whether a file is there, with those that it leads to."""
        there = self._folder.place(name).exists()
        return there and all(map(self._is_whole, set(_led_to(self._folder.read(name)))))

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


def _led_to(value: Any) -> Iterator[str]:
    """Go through the files that stand in the place of long answers."""
    if isinstance(value, dict):
        if isinstance(name := value.get("file"), str) and len(value) == 1:
            yield name
        for one in value.values():
            yield from _led_to(one)


def _short(value: Any) -> Any:
    """Return an answer with the digits of its columns that count."""
    if isinstance(value, dict):
        return {name: _short(one) for name, one in value.items() if name != "t"} | (
            {"t": np.round(np.asarray(value["t"], dtype=np.float64), 4)} if "t" in value else {}
        )
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return rounded(value, _DIGITS)
    return value
