# SPDX-License-Identifier: Apache-2.0
"""Result archives, error arrays and tables; evo_res opens the archives where evo is installed."""

from __future__ import annotations

import csv
import json
import re
import zipfile
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import Trajectory, write_tum
from slamhive_eval.command import main
from slamhive_eval.reports.result_tables import csv_table, latex_table

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

RPE = ["rpe", "--delta", "1", "--unit", "m", "--all-pairs"]


@pytest.fixture(name="files")
def files_fixture(tmp_path: Path, wander: Callable[..., Trajectory]) -> list[str]:
    truth = wander(300)
    write_tum(tmp_path / "gt.txt", truth)
    names = [str(tmp_path / "gt.txt")]
    for k, folder in enumerate(("a", "b")):
        noise = np.random.default_rng(k).normal(0, 0.01 * (k + 1), (300, 3))
        estimate = Trajectory(truth.stamps, truth.positions + noise, truth.quaternions)
        (tmp_path / folder).mkdir()
        names.append(str(tmp_path / folder / "est_1.txt"))
        write_tum(names[-1], estimate)
    return names


def run(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, float]:
    assert main([*words, "--json"]) == 0
    found: dict[str, float] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.parametrize("command", [["ape", "--align", "yaw"], RPE, [*RPE[:1], "--relation", "rot_part"]])
def test_archive_and_arrays(
    tmp_path: Path, files: list[str], capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    words = ["--save-results", str(tmp_path / "r.zip"), "--save-errors", str(tmp_path / "errors")]
    found = run(capsys, *command, *files[:2], *words)
    with zipfile.ZipFile(tmp_path / "r.zip") as archive:
        info = json.loads(archive.read("info.json"))
        statistics = json.loads(archive.read("stats.json"))
        with archive.open("error_array.npy") as file:
            errors = np.load(file)
        aligned = "alignment_transformation_sim3.npy" in archive.namelist()
    assert (info["ref_name"], info["est_name"]) == tuple(files[:2])
    assert info["title"].startswith(command[0].upper())
    assert aligned == ("yaw" in command)
    assert statistics == {name: found[name] for name in statistics}
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(found["rmse"])
    with np.load(tmp_path / "errors") as arrays:
        np.testing.assert_array_equal(arrays["error_array"], errors)
        assert arrays["timestamps"].shape == arrays["distances_from_start"].shape == errors.shape
        assert arrays["estimate_positions"].shape == (300, 3)
        if command[0] == "rpe":
            np.testing.assert_array_equal(
                arrays["seconds_from_start"],
                (arrays["timestamps"] - 1.6e9),
            )
            assert arrays["pairs"].shape == (len(errors), 2)


def test_several_estimates_into_a_folder(
    tmp_path: Path, files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "new" / "folder"
    run(capsys, "ape", *files, "--save-results", str(folder))
    assert sorted(path.name for path in folder.iterdir()) == ["est_1-1.zip", "est_1-2.zip"]
    assert main(["ape", *files, "--save-results", files[0]]) == 2
    assert "must be a folder: there are 2 estimates" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--save-results", "--save-errors", "--csv", "--latex"])
def test_what_cannot_be_written_is_named(
    tmp_path: Path, files: list[str], capsys: pytest.CaptureFixture[str], option: str
) -> None:
    place = str(tmp_path / "nowhere" / "x")
    assert main(["ape", *files[:2], option, place]) == 2
    err = capsys.readouterr().err
    assert f"{place}: can't be written: No such file" in err
    assert err.count("\n") == 1


def test_tables_of_results(tmp_path: Path, files: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--csv", str(tmp_path / "t.csv"), "--latex", str(tmp_path / "t.tex")]
    found = run(capsys, *RPE, *files, *words)["results"]
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["estimate"] for row in rows] == files[1:]
    assert [float(row["rmse"]) for row in rows] == [result["rmse"] for result in found]
    assert rows[0]["alignment"] == "none"
    text = (tmp_path / "t.tex").read_text()
    assert text.count(r"\textbf") == 6
    assert r"est\_1.txt & \textbf{" in text
    assert "RPE w.r.t. translation part (m) for delta = 1 (m) using all pairs (not aligned)" in text


def test_special_signs() -> None:
    rows = [{"name": "a,b_\\%", "x": 1.5e-7, "n": 3}, {"name": 'say "x"', "x": None}]
    assert csv_table(rows, ("name", "x", "n")) == 'name,x,n\n"a,b_\\%",1.5e-07,3\n"say ""x""",,\n'
    text = latex_table(rows, {"name": "name", "x": "x & y", "n": "n"}, "50 %", best=("n",))
    assert r"a,b\_\textbackslash{}\% & $1.5\times 10^{-7}$ & \textbf{3} \\" in text
    assert r"say \"x\" & -- & -- \\".replace(r"\"", '"') in text
    assert r"\caption{50 \%}" in text
    assert r"name & x \& y & n \\" in text


def test_evo_res_opens_the_archives(
    tmp_path: Path, files: list[str], capsys: pytest.CaptureFixture[str], evo: Callable[..., str]
) -> None:
    found = run(capsys, *RPE, *files, "--align", "se3", "--save-results", str(tmp_path / "zips"))["results"]
    zips = sorted(map(str, (tmp_path / "zips").iterdir()))
    table = tmp_path / "table.csv"
    printed = evo("evo_res", *zips, "--use_filenames", "--save_table", str(table), "--no_warnings")
    assert "RPE w.r.t. translation part (m)" in printed
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["rmse"]) for row in rows] == pytest.approx([one["rmse"] for one in found])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tum", "kitti", "euroc"])
def test_evo_traj_reads_what_traj_converts(
    tmp_path: Path, files: list[str], wander: Callable[..., Trajectory], evo: Callable[..., str], kind: str
) -> None:
    out = tmp_path / f"out.{kind}"
    assert main(["traj", files[0], "--output", str(out), "--output-format", kind]) == 0
    printed = evo("evo_traj", kind, str(out), "--full_check")
    facts = dict(re.findall(r"^\t([^\t]+)\t(.+)$", printed, re.MULTILINE))
    assert facts["nr. of poses"] == "300"
    assert float(facts["path length (m)"]) == pytest.approx(wander(300).path_length)
    checks = [
        facts[name]
        for name in ("SE(3) conform", "array shapes", "quaternions", "timestamps")
        if name in facts
    ]
    assert set(checks) <= {"ok", "yes"}
