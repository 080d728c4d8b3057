# SPDX-License-Identifier: Apache-2.0
"""Recordings that programs of a Dataset prepare, in sweeps: what they may take, how they fail, when again."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.programs.containers import Containers
from slamhive.local.running.choosing import RunChoice
from slamhive.local.running.runner import Job, Runner
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError
from slamhive.model.results import Phase, Reason
from slamhive.plan import Plan, impossible, local_uid, plan_problems, spec_hash

from .sweeps import Notes, sweep_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.local.home.folder import Home
    from slamhive.local.programs.engines import Engine
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.results import RunRecord

SHELL = "slamhive/shell-algorithm:1.0.0"
HEAD = f"""#!{sys.executable}
import os, sys, time
from pathlib import Path
given, out = Path(os.environ["SLAMHIVE_IN"]), Path(os.environ["SLAMHIVE_OUT"])
"""
COPY = """(out / "lidar").mkdir()
for path in (given / "lidar").glob("*.npy"):
    (out / "lidar" / path.name).write_bytes(path.read_bytes())
"""
PROGRAMS = {
    "copy": COPY,
    "crash": 'print("loading"); sys.exit("weights.pt: no such file")',
    "fewer": COPY + 'os.remove(out / "lidar/000007.npy")',
    "nothing": 'print("no people seen")',
    "filler": 'Path(os.environ["TMPDIR"], "x").write_bytes(bytes(1 << 22)); time.sleep(60)',
    "slow": 'print("waiting", flush=True); time.sleep(60)',
    "hungry": "held = bytearray(1 << 28); time.sleep(60)",
}
SENTENCES = {
    "crash": "failed: exit code 1; its log ends: loading | weights.pt: no such file (",
    "fewer": "wrote 99 of 100 frames of lidar; the first that is missing is lidar/000007.npy",
    "nothing": "wrote nothing; expected frames of lidar; its log ends: no people seen (",
    "filler": "failed: its output grew beyond the limit of 1 MiB; its log is empty",
    "slow": "failed: it took more than 0.5 s; its log ends: waiting (",
    "hungry": "failed: it needed more memory than its limit of 64 MiB; its log is empty",
}
LIMITS = {"filler": {"disk": "1Mi"}, "slow": {"timeout": "500ms"}, "hungry": {"memory": "64Mi"}}


@pytest.fixture
def prepared(home: Home, bench: Workbench) -> Callable[..., list[RunRecord]]:
    """Runs a sweep over programs of the small dataset, and returns its records by the order of the values."""
    place = bench.workshop.dataset_places["tiny"]

    def run(*names: str, **fields: object) -> list[RunRecord]:
        programs = {name: {"local": {"command": [f"{name}.py"]}, **LIMITS.get(name, {})} for name in PROGRAMS}
        programs |= run.programs  # type: ignore[attr-defined]
        for name, text in PROGRAMS.items():
            write(home.path / f"{name}.py", text)
        spec = place.dataset.spec.as_json() | {"preparations": programs}
        dataset = Dataset.model_validate(place.dataset.as_json() | {"spec": spec})
        bench.workshop.dataset_places["tiny"] = type(place)(dataset, place.folder)
        sweep = sweep_of(["good"], matrix=[{"path": "input.preparedBy", "values": list(names)}], **fields)
        job, notes = Job(sweep, local_uid(sweep), Plan(sweep, bench.workshop)), Notes()
        Runner(bench, notes, parallelism=2, wish=RunChoice()).run([job])
        return sorted(notes.records, key=lambda one: one.index)

    run.programs = {}  # type: ignore[attr-defined]
    return run


def write(path: Path, text: str) -> None:
    path.unlink(missing_ok=True)
    path.write_text(HEAD + text)
    path.chmod(0o755)


def test_programs_that_fail_are_told_by_name_and_cost_no_other_run(
    prepared: Callable[..., list[RunRecord]], home: Home, tmp_path: Path
) -> None:
    records = prepared("none", *SENTENCES, "copy", repetitions=2)
    by_name = dict(
        zip(["none", *SENTENCES, "copy"], zip(records[::2], records[1::2], strict=True), strict=True)
    )
    for name in ("none", "copy"):
        assert [one.phase for one in by_name[name]] == [Phase.SUCCEEDED] * 2
    for name, sentence in SENTENCES.items():
        for record in by_name[name]:
            assert (record.phase, record.reason) == (Phase.FAILED, Reason.PREPARATION_FAILED)
            assert record.message.startswith(f"the preparation {name!r} of dataset 'tiny' {sentence}")
            assert record.attempts == 0
    kept = [path for path in (home.path / "preparing").rglob("*") if path.is_file()]
    assert {path.name for path in kept} == {"log.txt"}
    assert len(kept) == len(SENTENCES)
    assert not [*(home.path / "variants").glob(".*.making")]
    assert tmp_path in home.path.parents


def test_a_program_that_changed_makes_its_runs_stale_and_no_others(
    prepared: Callable[..., list[RunRecord]], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, first = prepared("none", "copy")
    assert plain.provenance.prepared_by is None
    assert first.provenance.prepared_by
    assert first.provenance.content_hash != plain.provenance.content_hash
    assert not prepared("none", "copy")
    monkeypatch.setitem(PROGRAMS, "copy", "# another\n" + COPY)
    (again,) = prepared("none", "copy")
    assert (again.index, again.phase) == (1, Phase.SUCCEEDED)
    assert again.provenance.prepared_by != first.provenance.prepared_by


def test_a_name_that_no_dataset_has_is_a_mistake(
    prepared: Callable[..., list[RunRecord]], bench: Workbench
) -> None:
    prepared("none")
    wrong = sweep_of(["good"], matrix=[{"path": "input.preparedBy", "values": ["none", "cpy"]}])
    (problem,) = plan_problems(Plan(wrong, bench.workshop))
    assert problem == (
        "spec.matrix[0].values[1]: input.preparedBy: tiny has no preparation 'cpy'; did you mean 'copy'?"
    )
    assert not impossible(Plan(wrong, bench.workshop), {})


def test_none_is_a_run_without(run_spec: dict[str, Any]) -> None:
    assert spec_hash(run_spec | {"input": {"preparedBy": "none"}}) == spec_hash(run_spec | {"input": {}})
    assert spec_hash(run_spec | {"input": {"preparedBy": "copy"}}) != spec_hash(run_spec | {"input": {}})


@pytest.fixture
def run_spec() -> dict[str, Any]:
    """The spec of a run."""
    return {"algorithmRef": {"name": "actor"}, "datasetRef": {"name": "tiny"}}


def test_a_program_that_is_not_there_is_told(
    prepared: Callable[..., list[RunRecord]], bench: Workbench
) -> None:
    prepared("none")
    (bench.home.path / "copy.py").unlink()
    spec = {"datasetRef": {"name": "tiny"}, "sensors": "lidar", "input": {"preparedBy": "copy"}}
    with pytest.raises(
        InputError, match=r"the preparation 'copy' of dataset 'tiny' can't run here: .*copy\.py"
    ):
        bench.prepare(spec, bench.workshop.algorithm("actor").algorithm)


IN_CONTAINER = {
    "copy": "mkdir own/out/lidar && cp in/lidar/*.npy own/out/lidar && test $SLAMHIVE_OUT = $PWD/own/out",
    "crash": "echo hello; touch in/x; exit 4",
    "nothing": "exit 0",
    "filler": "dd if=/dev/zero of=$TMPDIR/x bs=1024 count=4096 && sleep 60",
    "hungry": "head -c 400000000 /dev/zero | tail -c 390000000 | wc -c",
}


@pytest.mark.usefixtures("podman")
def test_an_image_prepares_within_the_same_bounds(
    prepared: Callable[..., list[RunRecord]], bench: Workbench, podman: Engine
) -> None:
    for name, script in IN_CONTAINER.items():
        program = {"image": SHELL, "command": ["sh", "-c", script], **LIMITS.get(name, {})}
        prepared.programs[name] = program  # type: ignore[attr-defined]
    records = dict(zip(IN_CONTAINER, prepared(*IN_CONTAINER), strict=True))
    ok = records.pop("copy")
    assert (ok.phase, ok.message) == (Phase.SUCCEEDED, None)
    assert ok.provenance.prepared_by
    told = {name: record.message.partition("dataset 'tiny' ")[2] for name, record in records.items()}
    assert {record.reason for record in records.values()} == {Reason.PREPARATION_FAILED}
    assert told["crash"].startswith(
        "failed: exit code 4; its log ends: hello | touch: cannot touch 'in/x': Read-only file system ("
    )
    assert told["nothing"].startswith("wrote nothing; expected frames of lidar")
    assert told["filler"].startswith("failed: its output grew beyond the limit of 1 MiB")
    assert told["hungry"].startswith("failed: it needed more memory than its limit of 64 MiB")
    assert podman.labelled(f"io.slamhive.home={Containers(bench.home).identity()}") == []
