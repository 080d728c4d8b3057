# SPDX-License-Identifier: Apache-2.0
"""``slamhive report --run``: one run as a page that needs nothing but itself."""

from __future__ import annotations

import re
from html import unescape
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from slamhive.model.run import MappingRunSpec

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

NAME = "</script><script>alert(1)</script>"


@pytest.fixture
def walk(records: Any, fill: Callable[..., Path], tmp_path: Path) -> Path:
    """A home with a run whose names are markup, with path, ground truth and load; and one without files."""
    folder = tmp_path / "runs" / "study" / "walk"
    for one in (folder / "run" / "output", tmp_path / "groundtruth"):
        one.mkdir(parents=True)
    (tmp_path / "groundtruth" / "hall.txt").write_text(
        "".join(f"{k} {k} {k % 3} 0 0 0 0 1\n" for k in range(30))
    )
    (folder / "run" / "output" / "trajectory.txt").write_text(
        "".join(f"{k} {k} {k % 3} {k / 10} 0 0 0 1\n" for k in range(30))
    )
    (folder / "usage.csv").write_text("time_seconds,cpu_cores,resident_bytes\n0,1.0,1048576\n1,2.0,2097152\n")
    result = records.result("none", transform=np.eye(4).tolist(), ate={"rmse": 1.69})
    spec = {"datasetRef": {"name": "hall"}, "algorithmRef": {"name": NAME}}
    run = records.run(0, name="walk", folder=str(folder), results=[result], spec=spec, parameters={"x": NAME})
    return fill([run, records.failed(1, name="gone", message=NAME)])


def page(home: Path, slamhive: Callable[..., Any], *words: str) -> str:
    code, _, err = slamhive(home, "report", *words, "-o", home / "run.html")
    assert code == 0, err
    return (home / "run.html").read_text()


def test_it_says_what_ran_first_and_holds_path_errors_and_load(
    walk: Path, slamhive: Callable[..., Any]
) -> None:
    text = page(walk, slamhive, "--run", "walk")
    places = [text.index(f">{head}<") for head in ("Settings", "Results", "Path over the truth", "Load")]
    assert places == sorted(places)
    assert text.index("<details>") > text.index("slamhive run run.yaml --rerun") > places[-1]
    data = yaml.safe_load(re.search(r'id="data">(.*?)</script>', text)[1])  # type: ignore[index]
    (estimate,) = data["estimates"]
    assert max(estimate["errors"]["position"]) == pytest.approx(2.9)
    assert estimate["distance"][-1] > 29
    assert data["reference"]["path"][0][-1] == 29


def test_names_are_never_markup_and_no_script_runs_but_the_evaluators(
    walk: Path, slamhive: Callable[..., Any]
) -> None:
    for run in ("walk", "gone"):
        text = page(walk, slamhive, "--run", run, "--title", NAME)
        assert "alert(1)" in text
        assert "<script>alert" not in text
        assert "http" not in re.sub(r"http-equiv|http://www.w3.org/2000/svg", "", text)
        assert text.count("<script") == (2 if run == "walk" else 0)
        assert "unsafe-inline" not in text


def test_the_command_repeats_the_run(
    records: Any, fill: Callable[..., Path], slamhive: Callable[..., Any]
) -> None:
    home = fill([records.run(3, folder="/tmp/gone", parameters={"nFeatures": 700})])
    text = page(home, slamhive, "--run", "run-003")
    manifest = re.search(r'<pre tabindex="0">(.*?)</pre>', text, re.DOTALL)
    assert manifest is not None
    spec = MappingRunSpec.model_validate(yaml.safe_load(unescape(manifest[1]))["spec"])
    assert spec.parameters == {"nFeatures": 700}
    assert "Its files are not here" in text


def test_settings_say_of_what_they_are(
    records: Any, fill: Callable[..., Path], slamhive: Callable[..., Any]
) -> None:
    spec = {"resources": {"memory": "4Gi"}}
    run = records.run(3, parameters={"k": 7}, spec=spec, labels={"noise": "none"})
    text = page(fill([run]), slamhive, "--run", "run-003")
    told = [("parameters", "k 7"), ("resources", "memory 4Gi"), ("labels", "noise none")]
    for name, value in told:
        assert re.search(rf"<dt>{name}</dt><dd>[^<]*{value}", text), name


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--where", "coverage > 0"], "--run: a page of one run takes no --where, which is for several"),
        (["--evaluation", "sim3"], "--evaluation: unknown evaluation 'sim3'; known: none"),
    ],
)
def test_mistakes(walk: Path, slamhive: Callable[..., Any], words: list[str], sentence: str) -> None:
    code, _, err = slamhive(walk, "report", "--run", "walk", *words)
    assert code == 2
    assert sentence in " ".join(err.split())


@pytest.mark.browser
def test_a_browser_draws_it_with_no_request_and_no_barrier(
    walk: Path, slamhive: Callable[..., Any], browser: Any
) -> None:
    page(walk, slamhive, "--run", "walk")
    for options in ({}, {"width": 390}):
        browser.open((walk / "run.html").as_uri(), **options)
        assert browser.complaints == []
        assert browser.run("document.body.dataset.ready") == "true"
        assert browser.run("performance.getEntriesByType('resource').length") == 0
        assert browser.run("document.documentElement.scrollWidth <= innerWidth")
        # The path has the colours of its errors, the same in 2D and 3D.
        every = "[...document.querySelectorAll('#NAME .painted path')]"
        strokes = f"{every}.map((one) => one.getAttribute('stroke'))"
        colours = [set(browser.run(strokes.replace("NAME", name))) for name in ("path-xy", "path-3d")]
        assert colours[0] == colours[1]
        assert {"rgb(214,195,93)", "rgb(36,60,110)"} <= colours[0]
        # What the legend shows is drawn, too.
        signs = "[...document.querySelectorAll('#legend button rect')].map((one) => one.getAttribute('fill'))"
        assert colours[0] <= set(browser.run(signs))
    assert browser.barriers() == []
