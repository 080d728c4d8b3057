# SPDX-License-Identifier: Apache-2.0
"""``slamhive run --on cluster``: submit, wait, fetch, and show what a run on this machine would show."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from slamhive.cli.cluster.fetch import fetch_into
from slamhive.cli.cluster.work import ClusterPlace, Submission, read, show_sent, submit_to
from slamhive.cli.parts.console import (
    command_name,
    complain,
    emit,
    err,
    open_archive,
    out,
    remark,
    speaks_json,
)
from slamhive.cli.parts.exits import FAILED, INTERRUPTED
from slamhive.cli.parts.progress import Naming, run_line, run_values
from slamhive.cli.results import show_table
from slamhive.kube.api.errors import ApiError, NotFound
from slamhive.kube.api.kinds import Key, Kind, Object
from slamhive.kube.records import record_of
from slamhive.kube.user.queries import (
    extent,
    has_failed,
    is_over,
    is_stuck,
    name_of,
    runs_of,
    status_of,
    troubles,
)
from slamhive.local.home.folder import Home
from slamhive.model.base import plural
from slamhive.model.errors import InputError
from slamhive.model.results import Phase
from slamhive.model.sweep import Sweep
from slamhive.plan import SearchPlan

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from slamhive.kube.user.connecting import ConnectedCluster
    from slamhive.kube.user.fetching import Fetched
    from slamhive.kube.user.manifests import Manifest
    from slamhive.model.results import RunRecord


LOOK_SECONDS = 1.0
_LIST_SECONDS = 5.0
_NOTICE_SECONDS = 30.0
_REFUSED_SECONDS = 5.0
"""For so long a refusal has to stand: the operator may see a Sweep before the Datasets that came with it."""
_WATCHED = (Kind.SWEEP, Kind.MAPPING_RUN, Kind.EVALUATION)


@dataclass
class _AwaitedObject:
    """An object that is waited for.

    Attributes:
        key: its address.
        body: what was last seen of it; None: it is gone.
        stopped: why it is waited for no longer though it is not over.
        stuck_at: when it was first seen not to go on, s of the loop's clock; None: it goes on.
        told: runs that a line was printed of.
        listed_at: when its runs were last listed.
        listed: how many of them were done then.
        naming: words for its runs; None where they aren't planned here.
    """

    key: Key
    body: Object | None = None
    stopped: str | None = None
    stuck_at: float | None = None
    told: set[str] = field(default_factory=set)
    listed_at: float = 0.0
    listed: int = 0
    naming: Naming | None = None

    @property
    def is_done(self) -> bool:
        """Tell whether it is waited for no longer."""
        return self.stopped is not None or (self.body is not None and is_over(self.key.kind, self.body))

    @property
    def has_failed(self) -> bool:
        """Tell whether its end is not a good one."""
        if self.stopped is not None or self.body is None:
            return True
        found = status_of(self.body)
        if self.key.kind is Kind.MAPPING_RUN:
            return has_failed(self.body)
        return bool(found.get("failed")) or (self.key.kind is Kind.SWEEP and found.get("phase") != "Complete")


def run_on_cluster(files: Sequence[Path], place: ClusterPlace, parallelism: int | None) -> int:
    """Run manifests on a cluster to their end, as if that were this machine; returns the exit code."""
    submission = read(files, place)
    if not any(manifest.kind in _WATCHED for manifest in submission.manifests):
        raise InputError(f"{files[0]}: no Sweep, MappingRun or Evaluation in it")
    if parallelism is not None:
        submission.manifests = [_narrowed(manifest, parallelism) for manifest in submission.manifests]
    home = Home.from_environment()
    home.folder(".")
    submitted: list[_AwaitedObject] = []
    try:
        fetched = asyncio.run(_work(submission, home, submitted))
    except KeyboardInterrupt:
        return _interrupted(submitted, submission.place)
    by_name = {(item.key.kind, item.key.name): item for item in submitted}
    for one in fetched:
        if (one.kind, one.name) in by_name:
            _report(one, by_name[one.kind, one.name])
    for item in submitted:
        if item.key.kind is Kind.EVALUATION and item.body is not None:
            done = status_of(item.body).get("evaluated", 0)
            if speaks_json():
                emit("evaluation", name=item.key.name, evaluated=done)
            else:
                out.print(f"Evaluation {escape(item.key.name)}: {plural(done, 'run')} evaluated")
        if item.stopped:
            complain(f"{item.key.kind} {item.key.name}: {item.stopped}")
    return FAILED if any(item.has_failed for item in submitted) else 0


def _narrowed(manifest: Manifest, parallelism: int) -> Manifest:
    """Return a Sweep with another parallelism, and anything else as it is."""
    if not isinstance(manifest.item, Sweep):
        return manifest
    item = manifest.item.replace(spec=manifest.item.spec.replace(parallelism=parallelism))
    return replace(manifest, item=item, spec=manifest.spec | {"parallelism": parallelism})


async def _work(submission: Submission, home: Home, submitted: list[_AwaitedObject]) -> list[Fetched]:
    async with submission.place.connect() as cluster:
        sent = await submit_to(cluster, submission, with_catalog=True)
        show_sent(sent, submission, remark)
        for one in sent:
            if one.manifest.kind in _WATCHED:
                plan = submission.plans.get(str(one.manifest))
                # Nobody here knows what a search there will try.
                is_grid = plan is not None and not isinstance(plan, SearchPlan)
                naming = Naming(plan) if plan is not None and is_grid else None
                key = cluster.key(one.manifest.kind, one.manifest.name)
                submitted.append(_AwaitedObject(key, naming=naming))
                if plan is not None and speaks_json():
                    emit("begin", sweep=key.name, runs=plan.most_runs)
        await _wait(cluster, submitted)
        names = [item.key.name for item in submitted if item.key.kind is not Kind.EVALUATION and item.body]
        if not names:
            return []
        with open_archive(home) as archive:
            return (await fetch_into(archive, cluster, names)).fetched


async def _wait(cluster: ConnectedCluster, items: Sequence[_AwaitedObject]) -> None:
    """Wait for the end of all objects, and show how far they are."""
    columns = (
        *(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()),
        *(TextColumn("{task.fields[notes]}"), TimeElapsedColumn()),
    )
    loop = asyncio.get_running_loop()
    begun, warned = loop.time(), False
    hidden = not err.is_terminal or speaks_json()
    with Progress(*columns, console=err, refresh_per_second=2, disable=hidden) as progress:
        tasks = {
            item.key: progress.add_task(escape(item.key.name), total=None, notes="")
            for item in items
            if item.key.kind is not Kind.EVALUATION
        }
        while True:
            for item in items:
                if not item.is_done:
                    await _look(cluster, item, loop.time())
                if item.key in tasks and item.body is not None:
                    progress.update(tasks[item.key], **_shown(item.body))
            if all(item.is_done for item in items):
                return
            if not warned and loop.time() - begun > _NOTICE_SECONDS:
                warned = _warn(items)
            await asyncio.sleep(LOOK_SECONDS)


async def _look(cluster: ConnectedCluster, item: _AwaitedObject, now: float) -> None:
    """See what has become of an object; faults that pass leave it as it was."""
    try:
        item.body = await cluster.api.get(item.key)
        stuck = is_stuck(item.key.kind, item.body)
        item.stuck_at = None if stuck is None else item.stuck_at or now
        if item.stuck_at is not None and now - item.stuck_at >= _REFUSED_SECONDS:
            item.stopped = stuck
        if item.key.kind is Kind.SWEEP:
            await _tell_runs(cluster, item, item.body, now)
    except NotFound:
        item.body, item.stopped = None, "was deleted by someone"
    except ApiError as error:
        if not error.retryable:
            raise


async def _tell_runs(cluster: ConnectedCluster, item: _AwaitedObject, body: Object, now: float) -> None:
    """Print a line of each run that has ended since the last look."""
    found = status_of(body)
    done = found.get("succeeded", 0) + found.get("failed", 0)
    over = item.is_done
    if not over and (done == item.listed or now - item.listed_at < _LIST_SECONDS):
        return
    item.listed_at, item.listed = now, done
    for run in await runs_of(cluster, body):
        if is_over(Kind.MAPPING_RUN, run) and name_of(run) not in item.told:
            item.told.add(name_of(run))
            _tell(item, record_of(run), found.get("total"))


def _tell(item: _AwaitedObject, record: RunRecord, total: int | None) -> None:
    """Say in a line what came out of a run."""
    index, naming = record.index, item.naming
    if speaks_json():
        emit(
            "run",
            sweep=item.key.name,
            index=index,
            run=record.name,
            settings=naming.settings(index) if naming is not None and index is not None else {},
            repetition=record.spec.get("repetition", 0),
            done=len(item.told),
            runs=total,
            leftSeconds=None,
            **run_values(record),
            ateBefore=None,
        )
        return
    words = naming.words(index) or None if naming is not None and index is not None else None
    err.print(f"[dim]{len(item.told)}/{total or '?'}[/] {run_line(record, words)}")


def _shown(body: Object) -> dict[str, Any]:
    """Return the fields of an object's bar: total, completed, notes."""
    found = status_of(body)
    if body.get("kind") == Kind.MAPPING_RUN:
        over = is_over(Kind.MAPPING_RUN, body)
        return {"total": 1, "completed": int(over), "notes": str(found.get("phase", "Pending"))}
    notes = [f"{found['running']} in flight"] if found.get("running") else []
    notes += [f"[red]{found['failed']} failed[/]"] if found.get("failed") else []
    notes += [f"{found['evaluated']} evaluated"] if found.get("evaluated") else []
    total, done = extent(found)
    return {"total": total or None, "completed": done, "notes": " ".join(notes)}


def _warn(items: Sequence[_AwaitedObject]) -> bool:
    """Tell of objects that no operator has taken notice of; returns whether there were any."""
    ignored = [item for item in items if item.body is not None and not status_of(item.body).get("conditions")]
    for item in ignored:
        for sentence in troubles(item.key.kind, item.body or {}, float("inf")):
            remark(f"{item.key.name}: {sentence}")
    return bool(ignored)


def _report(fetched: Fetched, item: _AwaitedObject) -> None:
    """Print the table of a sweep's runs and a line of their number, as after a run on this machine."""
    if speaks_json():
        _emit_end(fetched, item)
        return
    if fetched.runs:
        out.print()
        show_table(sweep=fetched.stored, also=[])
    found = status_of(item.body or {})
    if item.key.kind is Kind.MAPPING_RUN:
        out.print(f"{escape(fetched.name)}: {found.get('phase')}")
    else:
        total, succeeded, failed = (found.get(key, 0) for key in ("total", "succeeded", "failed"))
        parts = [f"{succeeded} succeeded", f"{failed} failed"]
        waiting = total - succeeded - failed
        parts += [f"{waiting} not run ({found.get('phase')})"] if waiting else []
        parts += [f"{found['reused']} reused"] if found.get("reused") else []
        out.print(f"{escape(fetched.name)}: {plural(total, 'run')}: {', '.join(parts)}")
    if fetched.runs:  # else nobody knows the sweep here
        more = f"{command_name()} results table --sweep {fetched.stored}   (list, show, export)"
        out.print(f"More:       {more}", soft_wrap=True, markup=False)


def _emit_end(fetched: Fetched, item: _AwaitedObject) -> None:
    found = status_of(item.body or {})
    if item.key.kind is Kind.MAPPING_RUN:
        if item.body is not None and item.is_done:
            item.told.add(item.key.name)
            _tell(item, record_of(item.body), 1)
        succeeded = found.get("phase") == Phase.SUCCEEDED
        failed = item.body is not None and has_failed(item.body)
        counts = {"total": 1, "succeeded": int(succeeded), "failed": int(failed)}
    else:
        counts = {key: found.get(key, 0) for key in ("total", "succeeded", "failed")}
    emit(
        "end",
        sweep=fetched.name,
        runs=counts["total"],
        succeeded=counts["succeeded"],
        failed=counts["failed"],
        notRun=counts["total"] - counts["succeeded"] - counts["failed"],
        leftOut=0,
        doneBefore=None,
        reused=found.get("reused", 0),
        verdict=found.get("phase"),
        message=found.get("message"),
        folder=None,
    )


def _interrupted(submitted: Sequence[_AwaitedObject], place: ClusterPlace) -> int:
    names = " ".join(item.key.name for item in submitted)
    if not names:
        remark("interrupted while submitting; slamhive status shows what was begun")
        return INTERRUPTED
    name, options = command_name(), place.options
    remark(f"interrupted here; the cluster goes on with {names}")
    remark(f"  look:    {name} status {names} --watch{options}")
    remark(f"  results: {name} fetch {names}{options}")
    remark(f"  end it:  {name} cancel {names}{options}")
    return INTERRUPTED
