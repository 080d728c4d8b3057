# SPDX-License-Identifier: Apache-2.0
"""The commands ``slamhive submit``, ``logs`` and ``cancel``: their work on a cluster and what they print."""

from __future__ import annotations

import asyncio
import sys
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from slamhive.cli.parts.console import command_name, listing, out, remark
from slamhive.cli.parts.exits import INTERRUPTED
from slamhive.cli.parts.planning import planned, sweeps_of
from slamhive.cli.parts.searches import extent_text
from slamhive.cli.parts.sizes import size_refused
from slamhive.kube.api.kinds import Kind
from slamhive.kube.user import cancelling
from slamhive.kube.user.connecting import ConnectedCluster, connected, find_target
from slamhive.kube.user.logs import LogPart, read_log
from slamhive.kube.user.manifests import STDIN, Manifest, common_namespace, read_manifests
from slamhive.kube.user.submitting import (
    ClusterCatalog,
    Deed,
    Sent,
    left_behind,
    missing_entries,
    read_catalog,
    send,
    unable,
)
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.folder import Home
from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError
from slamhive.plan import FixedCatalog, plan_problems, probed

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Coroutine, Sequence

    from slamhive.model.base import Resource
    from slamhive.plan import Plan

_REFUSED = 20


@dataclass(frozen=True)
class ClusterPlace:
    """Kubernetes context and namespace that a command works in, as its options say.

    Attributes:
        context: context of the kubeconfig; None: the current one.
        namespace: the namespace; None: the context's.
    """

    context: str | None = None
    namespace: str | None = None

    @property
    def options(self) -> str:
        """Return the options that lead to the same place, with a space before them."""
        context = f" --context {self.context}" if self.context else ""
        return context + (f" -n {self.namespace}" if self.namespace else "")

    @asynccontextmanager
    async def connect(self) -> AsyncIterator[ConnectedCluster]:
        """Be connected to the cluster."""
        async with connected(find_target(self.context, self.namespace)) as cluster:
            yield cluster


@dataclass
class Submission:
    """Manifests to send, and what the cluster holds already.

    Attributes:
        manifests: what was given.
        place: where it goes.
        plans: the runs of each Sweep or MappingRun.
        added: entries of the catalog here that go along.
        notes: what the user should know.
    """

    manifests: list[Manifest]
    place: ClusterPlace
    plans: dict[str, Plan] = field(default_factory=dict)
    added: list[Manifest] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def attempt(work: Coroutine[Any, Any, None]) -> None:
    """Do some work; Ctrl-C ends it quietly."""
    try:
        asyncio.run(work)
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None


def submit(files: Sequence[Path], place: ClusterPlace, *, with_catalog: bool, dry_run: bool) -> None:
    """Send manifests and print what became of each, and what to type next."""

    async def work() -> None:
        submission = read(files, place)
        async with submission.place.connect() as cluster:
            sent = await submit_to(cluster, submission, with_catalog=with_catalog, dry_run=dry_run)
            namespace = cluster.namespace
        show_sent(sent, submission, lambda text: out.print(text, markup=False, soft_wrap=True), trial=dry_run)
        if dry_run:
            remark(f"dry run: nothing was made in namespace {namespace}")
        else:
            _show_next(sent, submission.place)

    attempt(work())


def logs(run: str, place: ClusterPlace, container: str, *, follow: bool, tail: int | None) -> None:
    """Print a run's log: its lines to standard output, remarks to standard error."""

    async def work() -> None:
        async with (
            place.connect() as cluster,
            aclosing(read_log(cluster, run, container, follow=follow, tail=tail)) as parts,
        ):
            async for part, text in parts:
                if part is LogPart.LINE:
                    sys.stdout.write(f"{text}\n")
                    sys.stdout.flush()
                else:
                    remark(text)

    attempt(work())


def cancel(names: Sequence[str], place: ClusterPlace, *, delete: bool) -> None:
    """End Sweeps and runs, or delete them, and print what happened to each."""

    async def work() -> None:
        async with place.connect() as cluster:
            act = cancelling.delete if delete else cancelling.cancel
            for sentence in await act(cluster, names):
                out.print(sentence, markup=False, soft_wrap=True)

    attempt(work())


def read(files: Sequence[Path], place: ClusterPlace) -> Submission:
    """Read manifests, before any cluster is asked.

    Raises:
        InputError: with a sentence for each mistake: file, line, field and what is allowed.
    """
    stdin = sys.stdin.read() if any(str(path) == STDIN for path in files) else None
    manifests = read_manifests(files, stdin)
    namespace = place.namespace or common_namespace(manifests, place.namespace)
    common_namespace(manifests, namespace)
    too_large = [f"{one.source}: {told}" for one in manifests if (told := size_refused(one.item))]
    if too_large:
        raise InputError("\n".join(too_large))
    return Submission(manifests, ClusterPlace(place.context, namespace))


async def submit_to(
    cluster: ConnectedCluster, submission: Submission, *, with_catalog: bool, dry_run: bool = False
) -> list[Sent]:
    """Check manifests against the catalogs here and there, and send them.

    Raises:
        InputError: with a sentence for each mistake; then nothing was made.
        ApiError: the cluster did not do it.
    """
    there = await read_catalog(cluster)
    _check(submission, there, with_catalog=with_catalog)
    return await send(cluster, [*submission.added, *submission.manifests], trial=dry_run)


def show_sent(
    sent: Sequence[Sent], submission: Submission, say: Callable[[str], None], *, trial: bool = False
) -> None:
    """Say what became of each object."""
    for note in submission.notes:
        remark(note)
    for one in sent:
        text = f"{one.manifest}: {'would be ' if trial and one.deed is not Deed.UNCHANGED else ''}{one.deed}"
        if one.changes:
            text += f" ({'; '.join(one.changes)})"
        plan = submission.plans.get(str(one.manifest))
        if one.manifest.kind is Kind.SWEEP and plan is not None:
            text += f", {extent_text(plan)}"
        say(text)


def _check(submission: Submission, there: ClusterCatalog, *, with_catalog: bool) -> None:
    """Check runs against the future catalog of the cluster, and note which entries to send along."""
    workshop = load_workshop(Home.from_environment())
    given = FixedCatalog.of(manifest.item for manifest in submission.manifests)
    here = FixedCatalog(workshop.algorithms, workshop.datasets) if with_catalog else FixedCatalog()
    catalog = FixedCatalog(
        {**here.algorithms, **there.items.algorithms, **given.algorithms},
        {**here.datasets, **there.items.datasets, **given.datasets},
    )
    problems = []
    for manifest in submission.manifests:
        for sweep in sweeps_of([manifest.item]):  # type: ignore[list-item]
            try:
                plan = planned(sweep, catalog, strict=True)
            except InputError as error:
                problems.append(str(error))
                continue
            problems += [f"{manifest}: {problem}" for problem in plan_problems(probed(plan))]
            submission.plans[str(manifest)] = plan
    problems += unable([*submission.plans.items()], catalog.algorithms)
    if problems:
        raise InputError("\n".join(problems[:_REFUSED]))
    local: dict[str, Resource] = {f"Algorithm {name}": item for name, item in here.algorithms.items()}
    local |= {f"Dataset {name}": item for name, item in here.datasets.items()}
    plans = [*submission.plans.values()]
    submission.added = missing_entries(plans, there, submission.manifests, local)
    if submission.added:
        names = listing([str(manifest) for manifest in submission.added])
        submission.notes.append(
            f"the cluster lacks {names}: taken from the catalog here (--no-catalog leaves them out)"
        )
    fresh = [item for item in (*submission.manifests, *submission.added) if not _known(item, there)]
    submission.notes += left_behind(fresh)


def _known(manifest: Manifest, there: ClusterCatalog) -> bool:
    return isinstance(manifest.item, Algorithm | Dataset) and there.has(manifest.kind, manifest.name)


def _show_next(sent: Sequence[Sent], place: ClusterPlace) -> None:
    """Print what to type next."""
    name, options = command_name(), place.options
    begun = [one.manifest.name for one in sent if one.manifest.kind in {Kind.SWEEP, Kind.MAPPING_RUN}]
    if not begun:
        return
    names = " ".join(begun) if len(begun) <= 3 else ""
    lines = [f"Next:  {name} status{f' {names}' if names else ''} --watch{options}"]
    if names:
        lines.append(f"       {name} fetch {names}{options}")
    for line in lines:
        out.print(line, markup=False, soft_wrap=True)
