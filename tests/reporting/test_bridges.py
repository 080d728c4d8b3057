# SPDX-License-Identifier: Apache-2.0
"""Runs written for other programs, read back by their own readers."""

from __future__ import annotations

import importlib.util
import json
import struct
import sys
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.model.canonical import digest
from slamhive.model.extras import how_to_install
from slamhive.model.results import Outcome, Phase, Result, RunRecord

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

# mlflow's own, and not ours to mend.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

SECONDS, CORES, BYTES = [0.0, 0.1, 0.2], [0.5, 1.5, 1.0], [1000.0, 3000.0, 2000.0]


def record(number: int, **changes: Any) -> RunRecord:
    fields: dict[str, Any] = {
        "uid": f"uid/{number}",
        "name": f"study-{number}",
        "sweep": "study",
        "spec": {
            "algorithmRef": {"name": "kiss-icp"},
            "datasetRef": {"name": "hall"},
            "sensors": "lidar",
            "parameters": {"voxelSize": 0.5 * (number + 1), "deskew": True},
            "input": {"pace": "Lockstep", "frameRate": 10},
            "repetition": number,
            "seed": 1 + number,
        },
        "phase": Phase.SUCCEEDED,
        "started": "2026-01-02T03:04:05Z",
        "finished": "2026-01-02T03:04:25Z",
        "usage": {"cpu": {"seconds": 10.0 + number}, "memory": {"peakBytes": 3000, "kind": "Resident"}},
        "provenance": {"contentHash": f"{number:064x}"},
        "results": [
            Result(
                evaluation="default",
                outcome=Outcome.TRACKED,
                coverage=0.95,
                values={"alignment": "se3", "ate": {"rmse": 0.1 + number}, "rpe": [{"rmse": 1 / 3}]},
            )
        ],
    }
    return RunRecord(**{**fields, **changes})


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home with three runs, the first one with files, the last one failed."""
    home = tmp_path / "home"
    folder = home / "runs" / "study" / "study-0"
    (folder / "output").mkdir(parents=True)
    lines = [f"{t},{cpu},{memory:.0f}" for t, cpu, memory in zip(SECONDS, CORES, BYTES, strict=True)]
    text = "seconds,cpu_cores,resident_bytes\n" + "\n".join(lines) + "\n"
    (folder / "usage.csv").write_text(text, encoding="utf-8")
    (folder / "output" / "trajectory.txt").write_text("0 0 0 0 0 0 0 1\n", encoding="utf-8")
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    keep(
        home,
        record(0, folder=str(folder), note="a robust kernel", tags=["robust", "v2"]),
        record(1),
        record(2, phase=Phase.FAILED, results=[], usage=None),
    )
    return tmp_path


def keep(home: Path, *records: RunRecord) -> None:
    with Archive.open(f"sqlite:///{home}/archive.sqlite") as archive:
        archive.put_runs(records)


def export(run_command: Any, to: str, out: Path, *more: str) -> str:
    code, said, err = run_command("results", "export", "--to", to, "-o", out, *more)
    assert code == 0, err
    return str(said)


def needs(module: str, extra: str) -> None:
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} isn't installed: pip install {extra}")


def test_tensorboard_reads_what_is_written(place: Path, run_command: Any) -> None:
    needs("tensorboard", "tensorboard tensorboardX")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from tensorboard.plugins.hparams import plugin_data_pb2

    assert "3 runs written, 0 there already" in export(run_command, "tensorboard", place / "tb")
    folders = sorted(path for path in (place / "tb" / "study").iterdir())
    assert [path.name.rpartition("-")[0] for path in folders] == ["study-0", "study-1", "study-2"]
    events = EventAccumulator(str(folders[0]), {"scalars": 0, "tensors": 0})
    events.Reload()
    assert events.Scalars("ate.rmse")[0].value == pytest.approx(0.1)
    assert events.Scalars("rpe.0.rmse")[0].value == pytest.approx(1 / 3)
    cpu = events.Scalars("usage/cpu_cores")
    assert [(one.step, one.value) for one in cpu] == [(0, 0.5), (100, 1.5), (200, 1.0)]
    assert cpu[0].wall_time == 1767323045.0
    assert [one.value for one in events.Scalars("usage/memory_bytes")] == BYTES
    plugin = events.summary_metadata["_hparams_/session_start_info"].plugin_data
    found = plugin_data_pb2.HParamsPluginData.FromString(plugin.content).session_start_info.hparams
    assert found["parameters.voxelSize"].number_value == 0.5
    assert found["algorithm"].string_value == "kiss-icp"
    tags = events.Tensors("tags/text_summary")[0].tensor_proto.string_val[0].decode()
    for text in ("| sweep | study |", "| dataset | hall |", "| repetition | 0 |", "| uid | uid/0 |"):
        assert text in tags
    files = events.Tensors("files/text_summary")[0].tensor_proto.string_val[0].decode()
    assert f"- {place / 'home'}/runs/study/study-0/output/trajectory.txt" in files


@pytest.mark.slow  # importing MLflow takes several seconds
def test_mlflow_reads_what_is_written(place: Path, run_command: Any) -> None:
    needs("alembic", "mlflow-skinny alembic")
    from mlflow import MlflowClient

    assert "3 runs written, 0 there already" in export(run_command, "mlflow", place / "ml")
    client = MlflowClient(tracking_uri=f"sqlite:///{place}/ml/mlflow.db")
    experiment = client.get_experiment_by_name("study")
    assert experiment is not None
    runs = {run.data.tags["uid"]: run for run in client.search_runs([experiment.experiment_id])}
    assert sorted(runs) == ["uid/0", "uid/1", "uid/2"]
    first = runs["uid/0"]
    assert first.info.run_name == "study-0"
    assert (first.info.start_time, first.info.status) == (1767323045000, "FINISHED")
    assert runs["uid/2"].info.status == "FAILED"
    assert first.data.params["parameters.voxelSize"] == "0.5"
    assert first.data.metrics["ate.rmse"] == pytest.approx(0.1)
    assert {name: first.data.tags[name] for name in ("sweep", "dataset", "repetition")} == {
        "sweep": "study",
        "dataset": "hall",
        "repetition": "0",
    }
    assert f"{place / 'home'}/runs/study/study-0/usage.csv" in first.data.tags["files"].splitlines()
    assert (first.data.tags["mlflow.note.content"], first.data.tags["tags"]) == (
        "a robust kernel",
        "robust, v2",
    )
    history = client.get_metric_history(first.info.run_id, "series/cpu_cores")
    assert [(one.step, one.value) for one in history] == [(0, 0.5), (100, 1.5), (200, 1.0)]


def log_records(content: bytes) -> Iterator[bytes]:
    """Yield the records of a LevelDB log, as a .wandb file is one after 7 bytes of its own."""
    assert content[:4] == b":W&B"
    position, whole = 7, b""
    while position + 7 <= len(content):
        left = 32768 - position % 32768
        if left < 7:
            position += left
            continue
        length, kind = struct.unpack("<HB", content[position + 4 : position + 7])
        whole += content[position + 7 : position + 7 + length]
        position += 7 + length
        if kind in {1, 4}:
            yield whole
            whole = b""


def test_wandb_reads_what_is_written(place: Path, run_command: Any) -> None:
    needs("wandb", "wandb")
    from wandb.proto import wandb_internal_pb2

    assert "3 runs written, 0 there already" in export(run_command, "wandb", place / "wb")
    found: dict[str, list[Any]] = {}
    for path in (place / "wb" / "wandb").glob("offline-run-*/*.wandb"):
        records = [wandb_internal_pb2.Record.FromString(data) for data in log_records(path.read_bytes())]
        found[next(one.run.display_name for one in records if one.HasField("run"))] = records
    assert sorted(found) == ["study-0", "study-1", "study-2"]
    run = next(one.run for one in found["study-0"] if one.HasField("run"))
    assert (run.project, run.run_group) == ("study", "study")
    assert {"dataset:hall", "repetition:0", "sweep:study", "uid:uid/0", "robust", "v2"} == set(run.tags)
    assert run.notes == "a robust kernel"
    config = {item.key: json.loads(item.value_json) for item in run.config.update}
    assert config["settings"]["parameters.voxelSize"] == 0.5
    assert f"{place / 'home'}/runs/study/study-0/usage.csv" in config["files"]
    summary = {
        item.key or "/".join(item.nested_key): json.loads(item.value_json)
        for one in found["study-0"]
        if one.HasField("summary")
        for item in one.summary.update
    }
    assert summary["ate.rmse"] == pytest.approx(0.1)
    steps = [
        {item.key or "/".join(item.nested_key): json.loads(item.value_json) for item in one.history.item}
        for one in found["study-0"]
        if one.HasField("history")
    ]
    assert [step["t"] for step in steps] == SECONDS
    usage = [step["usage"]["cpu_cores"] if "usage" in step else step["usage/cpu_cores"] for step in steps]
    assert usage == CORES
    exits = [one.exit.exit_code for one in found["study-2"] if one.HasField("exit")]
    assert exits == [1]


@pytest.mark.parametrize(
    ("to", "module", "extra"),
    [
        ("tensorboard", "tensorboardX", "tensorboardX"),
        pytest.param("mlflow", "alembic", "mlflow-skinny alembic", marks=pytest.mark.slow),
        ("wandb", "wandb", "wandb"),
    ],
)
def test_a_run_that_is_exported_twice_is_there_once(
    to: str, module: str, extra: str, place: Path, run_command: Any
) -> None:
    needs(module, extra)
    out = place / "out"
    export(run_command, to, out)
    assert "0 runs written, 3 there already" in export(run_command, to, out)
    keep(place / "home", record(1, usage={"wallSeconds": 7.0}), record(3))
    assert "2 runs written, 2 there already" in export(run_command, to, out)
    match to:
        case "tensorboard":
            assert len(list(out.glob("study/*/events*"))) == 4
        case "mlflow":
            from mlflow import MlflowClient

            client = MlflowClient(tracking_uri=f"sqlite:///{out}/mlflow.db")
            assert len(client.search_runs(["1"])) == 4
        case _:
            assert len(list(out.glob("wandb/offline-run-*/*.wandb"))) == 4


ODD = {
    "radius(m)": 1,
    "radius[m]": 2,
    "radius_m_": 3,
    "a/../b": 4,
    "/c//": 5,
    "x" * 300: 6,
    "line\nend": 7,
    "\x1b[31mred": 8,
    "weite_ü": 9,
}


@pytest.mark.parametrize(
    ("to", "module", "extra"),
    [
        ("tensorboard", "tensorboardX", "tensorboardX tensorboard"),
        ("mlflow", "alembic", "mlflow-skinny alembic"),
        ("wandb", "wandb", "wandb"),
    ],
)
def test_names_that_a_program_refuses_are_replaced_and_kept_apart(
    to: str, module: str, extra: str, place: Path, run_command: Any
) -> None:
    needs(module, extra)
    shared: dict[str, Any] = {"spec": record(0).spec | {"parameters": ODD}, "metrics": dict(ODD)}
    keep(place / "home", *(record(number, **shared) for number in (1, 2)))
    code, said, err = run_command("results", "export", "--to", to, "-o", str(place / "out"))
    assert (code, "3 runs written" in said) == (0, True), err
    parameters, metrics, kept = names_in(to, place / "out")
    assert sorted(parameters.values()) == sorted(metrics.values()) == sorted(ODD.values())
    odd = {"tensorboard": "metrics.radius(m)", "mlflow": "parameters.radius(m)"}.get(to)
    if odd is not None:
        assert f"for {odd}" in err
        assert odd in kept
        assert (metrics["metrics.radius_m_"], metrics["metrics.weite_ü"]) == (3, 9)


def names_in(to: str, out: Path) -> tuple[dict[str, float], dict[str, float], str]:
    """Return the parameters, the metrics and the tags of a run as a program reads them."""
    match to:
        case "mlflow":
            from mlflow import MlflowClient

            client = MlflowClient(tracking_uri=f"sqlite:///{out}/mlflow.db")
            run = client.search_runs(["1"], "tags.uid = 'uid/1'")[0].data
            settings, figures, kept = run.params, run.metrics, "\n".join(run.tags.values())
        case "tensorboard":
            from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
            from tensorboard.plugins.hparams import plugin_data_pb2

            events = EventAccumulator(str(next(out.glob("study/study-1-*"))), {"scalars": 0, "tensors": 0})
            events.Reload()
            plugin = events.summary_metadata["_hparams_/session_start_info"].plugin_data
            found = plugin_data_pb2.HParamsPluginData.FromString(plugin.content).session_start_info.hparams
            settings = {name: value.number_value for name, value in found.items()}
            figures = {name: events.Scalars(name)[0].value for name in events.Tags()["scalars"]}
            kept = events.Tensors("tags/text_summary")[0].tensor_proto.string_val[0].decode()
        case _:
            (path,) = out.glob(f"wandb/offline-run-*-{digest('uid/1')[:16]}/*.wandb")
            from wandb.proto import wandb_internal_pb2

            records = [wandb_internal_pb2.Record.FromString(data) for data in log_records(path.read_bytes())]
            (config,) = (
                json.loads(item.value_json)
                for one in records
                if one.HasField("run")
                for item in one.run.config.update
                if item.key == "settings"
            )
            settings, kept = config, ""
            figures = {
                item.key or "/".join(item.nested_key): json.loads(item.value_json)
                for one in records
                if one.HasField("summary")
                for item in one.summary.update
            }
    return (
        {name: float(value) for name, value in settings.items() if name.startswith("parameters.")},
        {name: value for name, value in figures.items() if name.startswith("metrics.")},
        kept,
    )


def test_figures_of_several_evaluations_are_told_apart(place: Path) -> None:
    from slamhive.analysis.selection import Selection, choose
    from slamhive.bridges.gathering import handed
    from slamhive.bridges.places import Here
    from slamhive.tables.reading import read_archive

    other = Result(evaluation="sim3", outcome=Outcome.PARTIAL, coverage=0.5, values={"ate": {"rmse": 7.0}})
    keep(place / "home", record(1).replace(results=[*record(1).results, other]))
    url = f"sqlite:///{place / 'home'}/archive.sqlite"
    frame = choose(read_archive(url), Selection()).frame
    with Here.open(url, place / "home") as here:
        runs = {run.uid: run for run in handed(frame, here)}
    assert len(runs) == 3
    figures = runs["uid/1"].figures
    assert (figures["default/ate.rmse"], figures["sim3/ate.rmse"]) == (1.1, 7.0)
    assert figures["usage.cpu.seconds"] == 11.0
    assert "ate.rmse" not in figures
    assert runs["uid/1"].tags["sim3/outcome"] == "Partial"


@pytest.mark.parametrize("to", ["tensorboard", "mlflow", "wandb"])
def test_a_library_that_is_missing_is_named(
    to: str, place: Path, run_command: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = {"tensorboard": "tensorboardX", "mlflow": "alembic", "rerun": "rerun"}.get(to, to)
    monkeypatch.setitem(sys.modules, module, None)
    words = ["view", "study-0"] if to == "rerun" else ["results", "export", "--to", to, "-o", place / "x"]
    code, _, err = run_command(*words)
    assert code == 2
    assert f", of the extra {to}: {how_to_install(to)}\n" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "--output: --to mlflow writes a folder: name it by -o DIR"),
        (["-o", "file"], "--output: file is there and no folder"),
        (["-o", "x", "--format", "csv"], "--format: is for rows; --to mlflow writes whole runs"),
        (["-o", "x", "--sweep", "studi"], "unknown"),
    ],
)
def test_what_does_not_fit_is_refused(
    words: list[str], message: str, place: Path, run_command: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)
    (place / "file").touch()
    code, out, err = run_command("results", "export", "--to", "mlflow", *words)
    assert (code, out) == (2, "")
    assert message in err
    assert not (place / "x").exists()
