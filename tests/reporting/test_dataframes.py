# SPDX-License-Identifier: Apache-2.0
"""``slamhive.results``: the rows of the archive as data frames."""

from __future__ import annotations

import json
import subprocess
import sys
from datetime import UTC, datetime
from importlib import import_module
from typing import TYPE_CHECKING, Any

import pytest

import slamhive
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture(scope="module")
def pd() -> Any:
    """pandas; all workers collect this file, and importing it takes half a second."""
    return import_module("pandas")


@pytest.fixture(scope="module")
def pl() -> Any:
    """polars, as pandas."""
    return import_module("polars")


def test_it_has_the_rows_and_values_of_an_export(
    pd: Any, assorted: Path, slamhive: Callable[..., Any]
) -> None:
    code, out, _ = slamhive(assorted, "results", "export", "--format", "json")
    assert code == 0
    expected = json.loads(out)
    found = results(assorted)
    assert len(found) == len(expected) == 31
    for name in (
        "uid",
        "evaluation",
        "ate.rmse",
        "parameters.nFeatures",
        "coverage",
        "repetition",
        "message",
    ):
        values = [None if pd.isna(value) else value for value in found[name]]
        assert values == [row.get(name) for row in expected], name


def results(*words: Any, **options: Any) -> Any:
    return slamhive.results(*words, **options)


def test_pandas_kinds(pd: Any, assorted: Path) -> None:
    found = results(assorted)
    assert isinstance(found, pd.DataFrame)
    kinds = {
        "ate.rmse": "float64",
        "repetition": "int64",
        "usage.memory.peakBytes": "Int64",
        "started": "datetime64[us, UTC]",
        "disturbed": "bool",
    }
    assert {name: str(found[name].dtype) for name in kinds} == kinds
    assert pd.api.types.is_string_dtype(found["algorithm"])
    assert found["started"][0] == pd.Timestamp("2026-01-02T03:04:00.25Z")
    assert found["ate.rmse"].isna().sum() == 2
    assert found["usage.memory.peakBytes"].isna().sum() == 1
    assert set(found["status"]) == {"Tracked", "Lost", "OutOfMemory", "NotEvaluated"}


def test_polars_kinds(pl: Any, assorted: Path) -> None:
    found = results(assorted, frame="polars")
    assert isinstance(found, pl.DataFrame)
    kinds = {
        "ate.rmse": pl.Float64,
        "repetition": pl.Int64,
        "started": pl.Datetime("us", "UTC"),
        "disturbed": pl.Boolean,
        "algorithm": pl.String,
    }
    assert {name: found.schema[name] for name in kinds} == kinds
    assert found["started"][0] == datetime(2026, 1, 2, 3, 4, 0, 250_000, tzinfo=UTC)
    assert found["ate.rmse"].null_count() == 2
    assert set(found["parameters.nFeatures"]) == {"500", "1000", "many", None}


@pytest.mark.parametrize("frame", ["pandas", "polars"])
def test_choosing(assorted: Path, frame: str) -> None:
    found = results(
        assorted, where="repetition == 0 and dataset == 'dataset-1'", columns="run, ate.rmse", frame=frame
    )
    assert list(found.columns) == ["run", "ate.rmse"]
    assert found.shape == (4, 2)
    assert results(assorted, sweep="study", frame=frame).shape[0] == 24
    assert results(assorted, sweep=["study", "later"], columns=["uid"], frame=frame).shape == (31, 1)
    with pytest.warns(UserWarning, match=r"has \d+ rows, and none is meant by where ate.rmse < 0"):
        assert results(assorted, where="ate.rmse < 0", frame=frame).shape[0] == 0


def test_an_evaluation_gives_each_run_once(pd: Any, assorted: Path, slamhive: Callable[..., Any]) -> None:
    columns = "uid,evaluation,outcome,ate.rmse,coverage,phase,usage.cpu.meanCores"
    words = ("results", "list", "--evaluation", "sim3", "--format", "json", "--columns", columns)
    expected = {row["uid"]: row for row in json.loads(slamhive(assorted, *words)[1])}
    found = results(assorted, evaluation="sim3")
    assert sorted(found["uid"]) == sorted(expected)
    for row in found.to_dict("records"):
        for name in ("outcome", "ate.rmse", "coverage", "phase", "usage.cpu.meanCores"):
            value = None if pd.isna(row[name]) else row[name]
            assert value == expected[row["uid"]][name]
    assert found["status"].tolist() == ["Tracked"]  # no other run was meant to be measured so


def test_places(assorted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = assorted / "archive.sqlite"
    for place in (assorted, str(assorted), file, f"sqlite:///{file}"):
        assert len(results(place, columns="uid")) == 31
    monkeypatch.setenv("SLAMHIVE_HOME", str(assorted))
    monkeypatch.delenv("SLAMHIVE_ARCHIVE", raising=False)
    assert len(results(columns="uid")) == 31


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"columns": "ate.rmes"}, "columns: unknown column 'ate.rmes'; did you mean 'ate.rmse'?"),
        ({"sweep": "studi"}, "sweep: unknown sweep 'studi'; did you mean 'study'?"),
        ({"evaluation": "yaw"}, "evaluation: unknown evaluation 'yaw'; known: se3, sim3"),
        ({"where": "ate.rmse <"}, "condition, character 11: expected a column"),
        ({"frame": "pands"}, "frame: unknown kind of data frame 'pands'; did you mean 'pandas'?"),
    ],
)
def test_mistakes(assorted: Path, options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError) as caught:
        results(assorted, **options)
    assert str(caught.value).startswith(sentence)


def test_no_archive(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no archive at .*absent/archive.sqlite"):
        results(f"sqlite:///{tmp_path}/absent/archive.sqlite")
    with pytest.raises(InputError, match="no archive at"):
        results(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_missing_library_is_named(assorted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(InputError, match="frame='polars' needs the package polars, of the extra polars: "):
        results(assorted, frame="polars")


def test_importing_slamhive_imports_nothing_else() -> None:
    heavy = {"numpy", "pandas", "polars", "sqlalchemy", "pydantic"}
    code = f"import sys, slamhive; print(sorted({heavy} & sys.modules.keys()))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_what_is_left_of_a_data_frame_is_drawn_as_the_command_draws_it(pd: Any, published: Path) -> None:
    runs = slamhive.results(published, where="sensors == 'rgbd'")
    drawn = runs[runs["parameters.nFeatures"] >= 1500].figure("lines", x="nFeatures", y="ate.rmse:cm")
    (axes,) = drawn.axes
    assert axes.get_ylabel() == "ATE RMSE [cm]"
    features = {tuple(line.get_xdata()) for line in axes.lines if len(line.get_xdata()) > 2}
    assert features == {(1500, 1750, 2000, 2250, 2500)}
    assert "n = " in drawn.caption
    with pytest.raises(InputError, match=r"did you mean 'lines'\?"):
        runs.figure("line")
    for wrong in ({"x": "typo"}, {"width": "12 miles"}, {"facet": "typo"}):
        (argument,) = wrong
        # A notebook has arguments, no options.
        with pytest.raises(InputError, match=rf"^{argument}: ") as found:
            runs.figure("lines", **({"x": "nFeatures"} | wrong))
        assert found.value.argument == argument
    with pytest.raises(InputError, match="needs the columns id and evaluation, of which 'id' is gone"):
        runs.drop(columns="id").figure("lines", x="nFeatures")
    with pytest.raises(InputError, match="not a data frame that slamhive"):
        pd.DataFrame({"id": [1]}).figure("lines")
