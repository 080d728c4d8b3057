# SPDX-License-Identifier: Apache-2.0
"""Runs that leave the cluster for the archive."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from testcluster.kept import RUN, Cluster, catalogued, standing

from slamhive.analysis.measuring import SETTINGS_KEY, settings_hash
from slamhive.archive import Archive
from slamhive.kube.api.kinds import Kind
from slamhive.kube.loop import Loop
from slamhive.kube.reconciling import reconcilers
from slamhive.kube.reconciling.archiving import at_its_end
from slamhive.kube.reconciling.sweep_runs import Finished, SweepTally
from slamhive.kube.records import record_of
from slamhive.kube.settings import EvaluationJobs
from slamhive.kube.status import iso
from slamhive.model.errors import InputError, SlamHiveError, SystemFault
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

RESULT = {"evaluation": "SE3", "outcome": "Tracked", "coverage": 1.0, "ate": {"rmse": 0.25}}
TRAJECTORY = {"poses": 10, "durationSeconds": 1.0, "sha256": "0" * 64, "path": "output/trajectory.txt"}


def a_run(**status: Any) -> dict[str, Any]:
    spec = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}}
    meta = {"name": "r", "uid": "u", "labels": {"slamhive.io/point": "3"}}
    return {
        "metadata": meta,
        "spec": spec,
        "status": {"phase": "Succeeded", "trajectory": TRAJECTORY} | status,
    }


@pytest.mark.parametrize("known", ["with its result", "without", "without, never archived", "no archive"])
async def test_what_another_operator_measured_and_removed_counts(tmp_path: Path, known: str) -> None:
    with Archive.open(f"sqlite:///{tmp_path / 'a.sqlite'}") as archive:
        if "never" not in known:
            archive.put_run(record_of(a_run(results=[RESULT]), attributes={}))
        seen = a_run(results=[RESULT]) if known == "with its result" else a_run()
        tally = SweepTally()
        tally.add(Finished.of(await at_its_end(None if known == "no archive" else archive, seen)))
    measured = known in {"with its result", "without"}
    assert (tally.evaluated, [item.ate for item in tally.best]) == ((1, [0.25]) if measured else (0, []))


def test_a_status_of_another_version_costs_what_can_t_be_read_of_it() -> None:
    known = record_of(a_run(results=[RESULT], attempts=2))
    later = {"frames": {"offered": 7, "skipped": 1}, "reason": "Levitated", "display": "figures"}
    record = record_of(a_run(results=[{"evaluation": "odd"}, RESULT], attempts=2, **later))
    assert record.frames is not None
    assert record.frames.offered == 7
    assert record.replace(frames=None) == known
    assert record_of(a_run(phase="Levitating")).phase is Phase.PENDING


class Switched:
    """An archive that can be made not to answer.

    Attributes:
        error: what it says to everything; None: it answers.
        calls: what it was asked.
    """

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        self.error: SlamHiveError | None = None
        self.calls: list[str] = []

    def __getattr__(self, name: str) -> Any:
        def method(*words: Any, **options: Any) -> Any:
            if self.error is not None:
                raise self.error
            self.calls.append(name)
            return getattr(self._archive, name)(*words, **options)

        return method


POINTS, WINDOW, RETENTION = 60, 4, 3


@pytest.fixture
def switched(tmp_path: Path) -> Iterator[Switched]:
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        yield Switched(archive)


@pytest.fixture
async def cluster(switched: Switched) -> Cluster:
    made = catalogued(archive=switched)  # type: ignore[arg-type]
    made.seen.identity = "cluster-1"
    return made


def a_sweep(cluster: Cluster) -> Any:
    spec = {"template": {"spec": RUN}, "repetitions": POINTS, "parallelism": WINDOW}
    return cluster.apply(Kind.SWEEP, "big", spec | {"retention": {"runs": RETENTION}})


def runs_of(cluster: Cluster) -> list[Any]:
    return [key for key in cluster.objects if key.kind is Kind.MAPPING_RUN]


async def go_on(cluster: Cluster, key: Any, looks: int, **left: Any) -> Any:
    """Let every run that was started end at once, and leave what is given."""
    status: Any = {}
    for _ in range(looks):
        status = await cluster.look(key, 11)
        for run in runs_of(cluster):
            body = cluster.objects[run]
            if not body["status"]:
                change(cluster, run, phase="Succeeded", completionTime=iso(cluster.now), **left)
    return status


def change(cluster: Cluster, run: Any, **status: Any) -> None:
    body = cluster.objects[run]
    cluster.objects[run] = cluster._made(body | {"status": body["status"] | status})
    cluster.seen.observe(Kind.MAPPING_RUN, "MODIFIED", cluster.objects[run])


@pytest.mark.parametrize(
    "error",
    [
        SystemFault("archive db: connection refused"),
        InputError("archive db: written by a newer slamhive (schema 9; this one knows up to 3)"),
    ],
)
async def test_an_archive_that_is_away_stops_new_runs_before_they_fill_the_cluster(
    cluster: Cluster, switched: Switched, error: SlamHiveError
) -> None:
    key = a_sweep(cluster)
    await go_on(cluster, key, 3)
    switched.error = error
    status = await go_on(cluster, key, 30)
    assert len(runs_of(cluster)) <= RETENTION + 2 * WINDOW
    assert status["pending"] > POINTS // 2
    assert standing(status, "ArchiveUnavailable") == ("True", "NoAnswer", str(error))
    assert cluster.told["big", "ArchiveUnavailable"] == str(error)
    assert cluster.seen.queue.delayed == 1
    switched.error = None
    status = await go_on(cluster, key, 60)
    assert standing(status, "ArchiveUnavailable")[0] == "False"
    assert (status["phase"], status["progress"]) == ("Complete", f"{POINTS}/{POINTS}")
    assert len(runs_of(cluster)) == RETENTION
    assert switched.count() == POINTS
    assert {(one.cluster, one.namespace) for one in switched.runs()} == {("cluster-1", "lab")}
    assert [one.cluster for one in switched.sweeps()] == ["cluster-1"]


async def test_runs_that_end_faster_than_they_are_measured_stop_new_ones(
    cluster: Cluster, switched: Switched
) -> None:
    slow = EvaluationJobs(batch_size=1, parallel_jobs=1, delay_seconds=0)
    cluster.seen.settings = cluster.seen.settings.replace(evaluation=slow)
    template = {"spec": RUN | {"evaluate": True}}
    spec = {"template": template, "repetitions": POINTS, "parallelism": WINDOW}
    key = cluster.apply(Kind.SWEEP, "big", spec | {"retention": {"runs": RETENTION}})
    status = await go_on(cluster, key, 30, trajectory=TRAJECTORY)
    waiting = len(runs_of(cluster))
    assert RETENTION + WINDOW + 2 <= waiting < RETENTION + 2 * WINDOW + 2
    assert switched.count() == 0
    word, reason, sentence = standing(status, "Blocked")
    assert (word, reason) == ("True", "CannotCreate")
    assert sentence == (
        f"{waiting} runs that have ended, {RETENTION} of them to keep, wait to be measured and archived"
    )
    measured = RESULT | {SETTINGS_KEY: settings_hash(EvaluationSettings())}
    for run in runs_of(cluster):
        change(cluster, run, results=[measured])
    status = await go_on(cluster, key, 60, results=[measured])
    assert standing(status, "Blocked")[0] == "False"
    assert (status["phase"], status["progress"]) == ("Complete", f"{POINTS}/{POINTS}")
    assert switched.count() == POINTS


async def test_an_archive_that_is_away_at_the_start_is_told_and_waited_for(
    cluster: Cluster, switched: Switched
) -> None:
    key = a_sweep(cluster)
    switched.error = SystemFault("archive db: connection refused")
    status = await go_on(cluster, key, 3)
    assert standing(status, "ArchiveUnavailable")[0] == "True"
    assert "Accepted" not in {item["type"] for item in status["conditions"]}
    assert runs_of(cluster) == []
    switched.error = None
    status = await go_on(cluster, key, 5)
    assert standing(status, "ArchiveUnavailable")[0] == "False"
    assert runs_of(cluster)


async def test_an_operator_that_comes_anew_to_an_absent_archive_starts_nothing(
    cluster: Cluster, switched: Switched
) -> None:
    key = a_sweep(cluster)
    await go_on(cluster, key, 3)
    before = len(runs_of(cluster))
    cluster.loop = Loop(cluster.seen, reconcilers(switched))  # type: ignore[arg-type]
    switched.error = SystemFault("archive db: connection refused")
    status = await go_on(cluster, key, 5)
    assert len(runs_of(cluster)) == before
    assert standing(status, "ArchiveUnavailable")[0] == "True"
    switched.error = None
    status = await go_on(cluster, key, 60)
    assert (status["phase"], status["progress"]) == ("Complete", f"{POINTS}/{POINTS}")


def deleted(cluster: Cluster, key: Any) -> None:
    cluster.seen.observe(key.kind, "DELETED", cluster.objects.pop(key))


def small(cluster: Cluster, **spec: Any) -> Any:
    return cluster.apply(Kind.SWEEP, "small", {"template": {"spec": RUN}, "repetitions": 4} | spec)


async def test_runs_are_in_the_archive_as_they_end_each_written_once(
    cluster: Cluster, switched: Switched
) -> None:
    key = small(cluster, parallelism=2)
    await go_on(cluster, key, 2)
    assert switched.count() == cluster.objects[key]["status"]["succeeded"] == 2
    status = await go_on(cluster, key, 4)
    assert (status["phase"], switched.count(), len(runs_of(cluster))) == ("Complete", 4, 4)
    written = switched.calls.count("put_used")
    cluster.loop = Loop(cluster.seen, reconcilers(switched))  # type: ignore[arg-type]
    await go_on(cluster, key, 2)
    assert switched.calls.count("put_used") == written <= 3
    # What an Evaluation measures later is written there too.
    change(cluster, runs_of(cluster)[0], results=[RESULT])
    await go_on(cluster, key, 2)
    assert [len(one.results) for one in switched.runs()].count(1) == 1


async def test_a_deleted_sweep_loses_nothing_that_had_ended(cluster: Cluster, switched: Switched) -> None:
    key = small(cluster, template={"spec": RUN | {"evaluate": True}})
    await go_on(cluster, key, 2, trajectory=TRAJECTORY)
    assert switched.count() == 0  # none is measured yet
    deleted(cluster, key)
    await cluster.loop.handle(key)
    assert [one.phase for one in switched.runs()] == [Phase.SUCCEEDED] * 4
    assert cluster.told["small", "Deleted"] == (
        "4 runs that had ended are in the archive, as are those that were retired; their folders stay where "
        "they are"
    )


async def test_a_run_by_itself_is_in_the_archive_as_it_ends(cluster: Cluster, switched: Switched) -> None:
    key = cluster.apply(Kind.MAPPING_RUN, "alone", RUN | {"cancel": True})
    await cluster.loop.handle(key)
    cluster.loop = Loop(cluster.seen, reconcilers(switched))  # type: ignore[arg-type]
    await cluster.loop.handle(key)
    assert [(one.name, one.reason) for one in switched.runs()] == [("alone", "Cancelled")]
    assert switched.calls.count("put_used") == 1


@pytest.mark.parametrize("kept", [True, False])
async def test_runs_that_are_deleted_by_hand_are_told_and_those_done_again_count_once(
    switched: Switched, kept: bool
) -> None:
    cluster = catalogued(archive=switched if kept else None)  # type: ignore[arg-type]
    key = small(cluster, parallelism=3)
    await cluster.look(key, 11)
    done, going, _ = runs_of(cluster)
    change(cluster, done, phase="Succeeded", completionTime=iso(cluster.now), results=[RESULT])
    await cluster.look(key, 11)
    again = cluster.objects[done]
    for run in (done, going):
        deleted(cluster, run)
    status = await cluster.look(key, 11)
    left = 1 if kept else 2
    told = f"2 runs were deleted by hand: nothing is left of {left}"
    assert standing(status, "Complete")[2] == told
    assert cluster.told["small", "RunsDeleted"] == (
        f"deleted by hand: {done.name}, {going.name}; in all {told}"
    )
    assert (status["deleted"], status["failed"], status["evaluated"]) == (2, 1, 1)
    cluster.objects[done] = again = cluster._made(again | {"status": {}})
    again["metadata"]["uid"] = "another"
    cluster.seen.observe(Kind.MAPPING_RUN, "ADDED", again)
    change(cluster, done, phase="Succeeded", completionTime=iso(cluster.now), results=[RESULT])
    for _ in range(2):
        status = await cluster.look(key, 11)
        assert (status["deleted"], status["evaluated"]) == (2, 1)
        cluster.loop = Loop(cluster.seen, reconcilers(switched if kept else None))  # type: ignore[arg-type]
    assert [one.uid for one in switched.runs()] == (["another"] if kept else [])


def annotate(cluster: Cluster, run: Any, **annotations: str) -> None:
    """Do what ``kubectl annotate mappingrun`` does."""
    meta = cluster.objects[run]["metadata"]
    given = {f"slamhive.io/{name}": text for name, text in annotations.items()}
    meta = meta | {"annotations": (meta.get("annotations") or {}) | given}
    cluster.objects[run] = cluster._made(cluster.objects[run] | {"metadata": meta})
    cluster.seen.observe(Kind.MAPPING_RUN, "MODIFIED", cluster.objects[run])


@pytest.mark.parametrize("alone", [True, False])
async def test_notes_and_tags_of_a_run_go_with_it_until_somebody_writes_others(
    cluster: Cluster, switched: Switched, alone: bool
) -> None:
    """A Sweep's template gives them to its runs; afterwards ``kubectl annotate`` changes one run's."""

    def noted() -> list[tuple[str | None, list[str]]]:
        return [(one.note, one.tags) for one in switched.runs()]

    words = {"slamhive.io/note": "tried the\nrobust kernel", "slamhive.io/tags": "robust, two words, v2"}
    if alone:
        key = cluster.apply(Kind.MAPPING_RUN, "alone", RUN | {"cancel": True}, annotations=words)
    else:
        template = {"spec": RUN, "metadata": {"annotations": words | {"slamhive.io/files": "mine"}}}
        key = small(cluster, template=template, repetitions=1)
    await go_on(cluster, key, 3)
    (run,) = runs_of(cluster)
    assert "slamhive.io/files" not in cluster.objects[run]["metadata"]["annotations"]
    assert noted() == [("tried the robust kernel", ["robust", "v2"])]
    annotate(cluster, run, tags="v3")
    await go_on(cluster, key, 2)
    assert noted() == [("tried the robust kernel", ["v3"])]
    cluster.loop = Loop(cluster.seen, reconcilers(switched))  # type: ignore[arg-type]
    annotate(cluster, run, note="while no operator looked")
    await go_on(cluster, key, 2)
    assert noted() == [("while no operator looked", ["v3"])]
    switched.annotate(["uid-" + run.name], lambda had: had.changed("by the command", ["v4"], []))
    annotate(cluster, run, note="too late")
    await go_on(cluster, key, 2)
    assert noted() == [("by the command", ["v3", "v4"])]
