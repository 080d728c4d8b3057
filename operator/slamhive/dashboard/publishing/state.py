# SPDX-License-Identifier: Apache-2.0
"""State of what a site shows, by content: what has the mark that it had is neither made nor written again."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from slamhive import __version__
from slamhive.analysis.grouping import SEARCHED, SUBJECT
from slamhive.analysis.selection import first_rows
from slamhive.dashboard.answering.encoding import encode_json
from slamhive.dashboard.answers import one_run
from slamhive.dashboard.publishing.runpages import poses_of
from slamhive.dashboard.sources.archived import Source
from slamhive.data.inspecting.overviews import FOLDER, kept_overview
from slamhive.tables.published import published_files

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from slamhive.dashboard.publishing.asking import PublishedRuns
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.dashboard.sources.looks import Looks

_SHORT = 12


class MarkedSource(Source, Protocol):
    """Source whose runs have looks."""

    def looks(self) -> Looks:
        """Return the looks that runs have now; called before the data are read."""


@dataclass(frozen=True)
class SiteState:
    """Marks of what a site is made from.

    Attributes:
        runs: marks of the pages of runs by UID, in the order of the table.
        whole: of all.
        alike: what the pages of runs have in common.
    """

    runs: Mapping[str, str]
    whole: str
    alike: one_run.RunsAlike


def state_of(source: PublishedRuns, snapshot: Snapshot, looks: Looks, wish: Any) -> SiteState:
    """Return the state of a site.

    Args:
        source: where the runs are.
        snapshot: its data.
        looks: of the runs, from before the data were read.
        wish: what the site depends on beside its data.
    """
    alike = one_run.RunsAlike()
    frame = snapshot.frame.select(first_rows(snapshot.frame))
    pages = [__version__, *poses_of(len(frame))]
    algorithms = [(one.name, one.content_hash) for one in source.catalog("Algorithm")]
    truths: dict[tuple[Any, ...], str] = {}
    subjects: dict[tuple[Any, ...], str] = {}
    names = ("uid", *SUBJECT, "sweep", "label.dataset", SEARCHED)
    marks: dict[str, str] = {}
    datasets = set()
    columns = (frame.column(one).tolist() for one in names)
    for uid, *subject, sweep, label, searched in zip(*columns, strict=True):
        key = tuple(subject)
        if key not in subjects:
            subjects[key] = _digest(pages, one_run.shared(snapshot, key, alike))
        look, files = looks.of(str(uid))
        told = [subjects[key], *key, sweep, look, files, searched]  # of several homes, names are told apart
        dataset = str(key[2])
        datasets.add(dataset)
        if files:
            place = (dataset, label)
            if place not in truths:
                truths[place] = _truth(source.truth(dataset, label))
            told += [algorithms, truths[place]]
        marks[str(uid)] = _digest(told)[:_SHORT]
    home = source.home()
    beside = [] if home is None else list(_beside(home, sorted(datasets)))
    return SiteState(
        marks, _digest(wish, pages, marks, looks.rest, snapshot.problems, source.describe(), beside), alike
    )


def _beside(home: Path, datasets: list[str]) -> Iterator[Any]:
    """Go through what answers take of a home beside its runs: published numbers, pictures of recordings."""
    for path in published_files(home):
        yield path.name, _hash(path.read_bytes())
    for name in datasets:
        yield name, _digest(kept_overview(home / "cache" / FOLDER, name))


def _truth(truth: Any) -> str:
    """Return a digest of a dataset's ground truth."""
    if truth is None:
        return ""
    poses = truth.poses
    return _digest(poses.stamps, poses.positions, poses.quaternions, truth.T_body_frame, truth.are_points)


def _digest(*values: Any) -> str:
    return _hash(encode_json(values))


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
