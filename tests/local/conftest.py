# SPDX-License-Identifier: Apache-2.0
"""A workbench on a home with the actor, and sweeps over its acts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.archive import Archive
from slamhive.local.home.catalog import Workshop
from slamhive.local.running.choosing import RunChoice
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.model.loading import load_file
from slamhive.plan import local_uid, plan_of

from .running.sweeps import Notes, sweep_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from slamhive.local.home.folder import Home
    from slamhive.model.sweep import Sweep


@pytest.fixture
def workshop(home: Home) -> Workshop:
    """The catalog of the home."""
    found = Workshop()
    found.add(load_file(home.path / "algorithms/actor/algorithm.yaml"), home.path / "algorithms/actor")
    found.add(load_file(home.path / "tiny.yaml"), home.path)
    return found


@pytest.fixture
def bench(home: Home, workshop: Workshop) -> Iterator[Workbench]:
    """A workbench on the home."""
    with Archive.open(home.archive_url) as archive:
        yield Workbench(home, workshop, archive)


@pytest.fixture
def run_sweep(bench: Workbench) -> Callable[..., tuple[Job, Notes]]:
    """Runs a sweep, and returns the job and what was told of it."""

    def run(sweep: Sweep, *, rerun: bool = False, parallelism: int = 2) -> tuple[Job, Notes]:
        job = Job(sweep, local_uid(sweep), plan_of(sweep, bench.workshop))
        notes = Notes()
        Runner(bench, notes, parallelism=parallelism, wish=RunChoice(rerun=rerun)).run([job])
        return job, notes

    return run


@pytest.fixture
def run_acts(run_sweep: Callable[..., tuple[Job, Notes]]) -> Callable[..., tuple[Job, Notes]]:
    """Runs a sweep over acts, and returns the job and what was told of it."""

    def run(acts: Sequence[str], *, rerun: bool = False, **fields: object) -> tuple[Job, Notes]:
        return run_sweep(sweep_of(acts, **fields), rerun=rerun)  # type: ignore[arg-type]

    return run
