# SPDX-License-Identifier: Apache-2.0
"""A ROS 1 node and its player as two containers of this machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.archive import Archive
from slamhive.local.home.catalog import load_workshop
from slamhive.local.programs.containers import Containers
from slamhive.local.programs.containerwords import HOME_LABEL
from slamhive.local.programs.engines import ContainerChoice
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.model.loading import load_file
from slamhive.model.results import Phase
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid

if TYPE_CHECKING:
    from slamhive.local.home.folder import Home
    from slamhive.local.programs.engines import Engine
    from slamhive.model.results import RunRecord

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

FRAMES = 100


@pytest.fixture
def played(home: Home, notes: object, podman: Engine) -> RunRecord:
    """A run of KISS-ICP's node in its image, and nothing left of its containers."""
    workshop = load_workshop(home)
    workshop.add(load_file(home.path / "tiny.yaml"), home.path)
    template = {
        "algorithmRef": {"name": "kiss-icp-ros"},
        "datasetRef": {"name": "tiny"},
        # At half its speed, so that a busy machine keeps up with some of it.
        "input": {"pace": "Realtime", "rate": 0.5},
        "timeout": "10m",
    }
    sweep = Sweep.model_validate({"metadata": {"name": "boxed"}, "spec": {"template": {"spec": template}}})
    with Archive.open(home.archive_url) as archive:
        job = Job(sweep, local_uid(sweep), Plan(sweep, workshop))
        bench = Workbench(home, workshop, archive, container=ContainerChoice.PODMAN)
        Runner(bench, notes).run([job])  # type: ignore[arg-type]
        record = archive.get(job.run_uid(0))
    assert record is not None
    assert podman.labelled(f"{HOME_LABEL}={Containers(home).identity()}") == []
    return record


def test_a_node_in_its_image_is_played_to_by_the_players(played: RunRecord) -> None:
    assert played.phase is Phase.SUCCEEDED, f"{played.message}\n{played.log_tail}"
    frames = played.frames
    assert frames is not None
    # A busy machine drops some, however slowly they come.
    assert frames.offered == FRAMES
    assert (frames.processed or 0) + (frames.dropped or 0) == FRAMES
    assert played.trajectory is not None
    assert 20 < played.trajectory.poses <= (frames.processed or 0)
    assert played.metrics["latencySeconds"]["mean"] > 0
    assert played.provenance.image_id is not None
    assert played.usage is not None
    assert played.usage.source.startswith("cgroup")
    assert played.usage.cpu.total_seconds > 0
