# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/datasets/NAME/overview``: what is drawn of a dataset's recording, as it was kept in the home."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.problems import Missing
from slamhive.data.inspecting.overviews import FOLDER, kept_overview

if TYPE_CHECKING:
    from slamhive.dashboard.sources.archived import Snapshot, Source


def kept(source: Source, name: str) -> dict[str, Any]:
    """Return the overview of a dataset.

    Raises:
        Missing: it was not made, or can't be here.
    """
    home = source.home()
    if home is None:
        raise Missing("the recording is not at hand here: its picture is shown on a workstation that has it")
    found = kept_overview(home / "cache" / FOLDER, name) if len(name) <= 253 else None
    if found is None:
        raise Missing(
            "there is no picture of its recording yet; this makes it: slamhive dataset show "
            f"{name[:253]} --html"
        )
    return found


def overview(snapshot: Snapshot, found: dict[str, Any]) -> Body:
    """Return the drawings of a dataset's recording."""
    return Body({"revision": snapshot.revision, **found})
