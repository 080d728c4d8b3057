# SPDX-License-Identifier: Apache-2.0
"""The report's data and page, in a browser where one is installed; figures where matplotlib is."""

from __future__ import annotations

import json
import re
import subprocess
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import OptionError, Options, Trajectory, evaluate, write_tum
from slamhive_eval.command import main
from slamhive_eval.reports.report import BINS, MAX_POINTS, report_data, report_html

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive_eval import Evaluation

PLOTS = ("path-xy", "path-xz", "path-yz", "path-3d", "error-time", "error-distance", "histogram", "boxes")
EXERCISE = """<script>
for (const [id, type] of [["error-time", "pointermove"], ["error-distance", "pointermove"]]) {
  const place = document.getElementById(id).getBoundingClientRect();
  document.getElementById(id).dispatchEvent(
    new PointerEvent(type, { clientX: place.left + place.width / 2, clientY: place.top + 5 }));
}
const before = document.querySelector("#path-3d .curve").getAttribute("d");
document.getElementById("path-3d").dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
document.body.dataset.turned = before !== document.querySelector("#path-3d .curve").getAttribute("d");
document.body.dataset.marks = document.querySelectorAll(".mark").length;
document.body.dataset.overflow = document.documentElement.scrollWidth > window.innerWidth;
document.querySelectorAll("#kinds button")[1].click();
document.body.dataset.caption = document.querySelector("caption").textContent;
document.querySelector("#legend button").click();
document.body.dataset.curves = document.querySelectorAll("#path-xy .curve").length;
document.querySelectorAll("#legend button").forEach((button) => button.click());
</script></body>"""


@pytest.fixture(name="found")
def found_fixture(wander: Callable[..., Trajectory]) -> tuple[Trajectory, dict[str, Evaluation]]:
    truth = wander(4000)
    noise = np.random.default_rng(0).normal(0, 0.02, (4000, 3))
    noise[1234] = (0.0, 3.0, 4.0)
    noisy = Trajectory(truth.stamps, truth.positions + noise, truth.quaternions)
    hole = truth.select(np.r_[0:500, 700:1000])
    estimates = {"noisy": noisy, "hole </script><b>&": hole, "lost": truth.select(slice(0, 2))}
    asked = Options(alignment="none")
    return truth, {name: evaluate(truth, estimate, asked) for name, estimate in estimates.items()}


def test_data(found: tuple[Trajectory, dict[str, Evaluation]]) -> None:
    truth, evaluations = found
    data = report_data(truth, evaluations, title="t", reference_name="gt")
    noisy, hole, lost = data["estimates"]
    assert lost["time"] == []
    assert "2 of 2 poses" in lost["message"]
    assert noisy["thinned"]
    assert not hole["thinned"]
    assert len(noisy["time"]) <= MAX_POINTS
    assert max(noisy["errors"]["position"]) == pytest.approx(5.0)
    k = int(np.argmax(noisy["errors"]["position"]))
    assert noisy["time"][k] == pytest.approx(123.4)
    assert noisy["distance"][k] == pytest.approx(truth.distances[1234], rel=1e-5)
    assert (noisy["time"][0], noisy["time"][-1]) == (0.0, pytest.approx(399.9))
    assert (noisy["breaks"], hole["breaks"]) == ([], [500])
    assert hole["path"][2] == pytest.approx(truth.positions[np.r_[0:500, 700:1000], 2], abs=1e-4)
    counts, errors = noisy["histogram"]["position"], evaluations["noisy"].poses.errors
    assert (len(counts), sum(counts)) == (BINS, 4000)
    assert data["edges"]["position"][-1] < 0.2  # one outlier of 5 m doesn't stretch the bins
    low, middle, high = np.quantile(errors, (0.25, 0.5, 0.75))
    box = noisy["box"]["position"]
    assert (box["q1"], box["median"], box["q3"]) == pytest.approx((low, middle, high), rel=1e-3)
    assert box["max"] == pytest.approx(5.0)
    assert box["high"] <= high + 1.5 * (high - low) < box["max"]


def test_page_needs_nothing_else(found: tuple[Trajectory, dict[str, Evaluation]]) -> None:
    page = report_html(*found, title="a <title> & @DATA@")
    assert set(re.findall(r"https?://[^\"' ]+", page)) <= {"http://www.w3.org/2000/svg"}
    assert "default-src 'none'" in page
    assert page.count("</script>") == 2
    assert "<title>a &lt;title&gt; &amp; @DATA@</title>" in page
    embedded = re.search(r'<script type="application/json" id="data">(.*)</script>', page)
    assert json.loads(embedded[1])["estimates"][1]["name"] == "hole </script><b>&"
    assert len(page) < 400_000
    with pytest.raises(OptionError, match="at least one estimate"):
        report_html(found[0], {})


@pytest.mark.parametrize("poses", [3, 1500, 1501])
def test_still_and_short_estimates(wander: Callable[..., Trajectory], poses: int) -> None:
    truth = wander(poses)
    still = Trajectory(truth.stamps, np.zeros((poses, 3)), np.tile((0.0, 0, 0, 1), (poses, 1)))
    page = report_html(still, {"still": evaluate(still, still), "huge": evaluate(truth, still)})
    assert "NaN" not in page.partition('id="data">')[2].partition("</script>")[0]
    nothing = report_html(truth, {"lost": evaluate(truth, still.select(slice(0, 1)))})
    assert "lost" in nothing


@pytest.fixture(name="browser", scope="session")
def browser_fixture(
    chromium: str, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., tuple[str, str]]:
    quiet = ("gpu", "quic", "background-networking", "component-update", "sync", "dev-shm-usage")
    options = ["--headless", "--no-sandbox", "--no-first-run", *(f"--disable-{part}" for part in quiet)]
    options += ["--enable-logging=stderr", "--virtual-time-budget=5000", "--dump-dom"]

    def dump(page: Path, width: int = 1300) -> tuple[str, str]:
        profile = tmp_path_factory.mktemp("profile")
        where = [
            f"--user-data-dir={profile}",
            f"--window-size={width},2000",
            "--host-resolver-rules=MAP * ~NOTFOUND",
        ]
        done = subprocess.run(
            [chromium, *options, *where, page.as_uri()],
            capture_output=True,
            text=True,
            check=True,
            timeout=300,
        )
        return done.stdout, "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)

    return dump


@pytest.mark.browser
@pytest.mark.parametrize("width", [1300, 500])
def test_every_plot_is_drawn_without_an_error(
    tmp_path: Path, found: tuple[Trajectory, dict[str, Evaluation]], browser: Any, width: int
) -> None:
    page = tmp_path / "report.html"
    page.write_text(report_html(*found).replace("</body>", EXERCISE))
    dom, errors = browser(page, width)
    assert errors == ""
    assert 'data-ready="true"' in dom
    assert 'data-turned="true"' in dom
    assert 'data-overflow="false"' in dom
    assert 'data-marks="12"' in dom  # two estimates on six plots
    assert 'data-curves="1"' in dom  # one of them hidden
    assert 'data-caption="Rotation error [°]' in dom
    assert "NaN" not in re.sub(r"<script.*?</script>", "", dom, flags=re.DOTALL)
    assert "<b>" not in dom.partition("<script")[0]


@pytest.mark.browser
def test_every_plot_holds_its_curves(
    tmp_path: Path, found: tuple[Trajectory, dict[str, Evaluation]], browser: Any
) -> None:
    page = tmp_path / "report.html"
    page.write_text(report_html(*found))
    dom, errors = browser(page)
    assert errors == ""
    for name in PLOTS:
        drawn = re.search(rf'<svg[^>]* id="{name}"[^>]*>.*?</svg>', dom, re.DOTALL)
        assert drawn
        assert 'aria-label="' in drawn[0]
        assert len(re.findall(r'class="(?:curve|box)"', drawn[0])) == 2, name
        assert (name.startswith("path")) == ('class="truth"' in drawn[0])
    assert len(re.findall("<tr>", dom)) == 4


@pytest.fixture(name="files")
def files_fixture(tmp_path: Path, wander: Callable[..., Trajectory]) -> list[str]:
    names = [str(tmp_path / name) for name in ("gt.txt", "a.txt", "b.txt")]
    for seed, name in enumerate(names):
        write_tum(name, wander(seed=seed))
    return names


def test_command(tmp_path: Path, files: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "out.html"
    assert main(["report", *files, "-o", str(page), "--title", "Walk", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["written"] == [str(page)]
    assert list(told["estimates"]) == ["a", "b"]
    assert "<h1>Walk</h1>" in page.read_text()
    assert main(["report", *files, "-o", str(page)]) == 0
    assert capsys.readouterr().out == f"{page}\n"


@pytest.mark.parametrize("command", ["report", "ape", "rpe"])
def test_common_support(
    tmp_path: Path, wander: Callable[..., Trajectory], capsys: pytest.CaptureFixture[str], command: str
) -> None:
    parts = {"gt": slice(0, 200), "a": slice(0, 120), "b": slice(60, 200)}
    for name, part in parts.items():
        write_tum(tmp_path / name, wander().select(part))
    words = [command, *(str(tmp_path / name) for name in parts), "--json"]
    words += ["-o", str(tmp_path / "r.html")] if command == "report" else []
    for support, poses in (("own", [120, 140]), ("common", [60, 60])):
        assert main([*words, "--support", support]) == 0
        told = json.loads(capsys.readouterr().out)
        each = told["estimates"].values() if command == "report" else told["results"]
        assert [one["poses"] for one in each] == poses


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["-o", "{here}/none/r.html"], "none/r.html: can't be written: No such file"),
        (["--figure", "{here}/r.bmp"], "must end in .png, .svg, .pdf, not '.bmp'"),
        (["{here}/a.txt"], "the same estimate is given twice"),
    ],
)
def test_wrong_input_is_one_sentence(
    tmp_path: Path, files: list[str], capsys: pytest.CaptureFixture[str], words: list[str], says: str
) -> None:
    assert main(["report", *files, *(word.format(here=tmp_path) for word in words)]) == 2
    out, err = capsys.readouterr()
    assert says in err
    assert (out, err.count("\n")) == ("", 1)


@pytest.mark.parametrize(("suffix", "begins"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_figures(
    tmp_path: Path, files: list[str], capsys: pytest.CaptureFixture[str], suffix: str, begins: bytes
) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is an extra")
    figure = tmp_path / f"figure.{suffix}"
    assert main(["report", *files, "--figure", str(figure)]) == 0
    assert capsys.readouterr().out == f"{figure}\n"
    assert figure.read_bytes().startswith(begins)
    if suffix == "png":  # drawing takes seconds, and no kind is written in a way of its own
        assert main(["report", *files, "--figure", str(tmp_path / "none" / "figure.png")]) == 2
        assert "can't be written" in capsys.readouterr().err


def test_figures_without_matplotlib_say_what_they_need(
    tmp_path: Path, files: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    assert main(["report", *files, "--figure", str(tmp_path / "f.png")]) == 2
    assert "figures need matplotlib: pip install matplotlib" in capsys.readouterr().err
