# SPDX-License-Identifier: Apache-2.0
"""All mistakes of all files are told at once, each where it stands; what follows from one is not told."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.cli.parts.checked import MOST, check_files
from slamhive.local.home.catalog import load_workshop
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.cli.parts.checked import Checked

HEAD = "apiVersion: slamhive.io/v1alpha1\nkind: {kind}\nmetadata: {{name: {name}}}\nspec:\n"
TEMPLATE = "  template: {spec: {algorithmRef: {name: kiss-icp}, datasetRef: {name: synthetic-lidar}}}\n"


def manifest(body: str, kind: str = "Sweep", name: str = "s") -> str:
    return HEAD.format(kind=kind, name=name) + body


@pytest.fixture
def check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Checked]:
    """Checks texts as the files a.yaml, b.yaml, …"""
    monkeypatch.chdir(tmp_path)
    workshop = load_workshop()

    def look(*texts: str, strict: bool = True, misfits: bool = False) -> Checked:
        paths = [
            tmp_path.relative_to(tmp_path) / f"{letter}.yaml"
            for letter, _ in zip("abcd", texts, strict=False)
        ]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text, encoding="utf-8")
        return check_files(paths, workshop, strict=strict, misfits=misfits)

    return look


def test_mistakes_of_all_stages_are_told_together(check: Callable[..., Checked]) -> None:
    text = manifest(
        "  repetitons: 3\n"
        "  template:\n"
        "    spec:\n"
        "      algorithmRef: {name: kiss-icp}\n"
        "      datasetRef: {name: synthetic-ldar}\n"
        "      parameters: {voxelSise: 1}\n"
        "      input: {framerate: 2, pace: Fast}\n"
        "  matrix:\n"
        "    - {path: parameter.voxelSize, values: [0.5]}\n"
        "    - {path: seed, vals: [1]}\n"
        "    - {path: parameters.maxRange, values: [0.5, 30]}\n"
        "    - {path: sensors, values: [mono]}\n"
        "  include: [{retries: x}]\n"
    )
    assert [problem.split(": ")[:3] for problem in check(text).problems] == [
        ["a.yaml:5", "spec.repetitons", "unknown field 'repetitons'; did you mean 'repetitions'?"],
        ["a.yaml:9", "spec.template.spec", "datasetRef.name"],
        ["a.yaml:10", "spec.template.spec", "parameters.voxelSise"],
        [
            *("a.yaml:11", "spec.template.spec.input.framerate"),
            "'input.framerate' is no field of a MappingRun's spec; did you mean 'input.frameRate'?",
        ],
        ["a.yaml:11", "spec.template.spec.input.pace", "unknown value 'Fast'; known"],
        [
            "a.yaml:13",
            "spec.matrix[0].path",
            "'parameter.voxelSize' is no field of a MappingRun's spec; known",
        ],
        ["a.yaml:14", "spec.matrix.1.vals", "unknown field 'vals'; did you mean 'values'?"],
        ["a.yaml:15", "spec.matrix[2].values[0]", "parameters.maxRange"],
        ["a.yaml:16", "spec.matrix[3].values[0]", "sensors"],
        ["a.yaml:17", "spec.include[0].retries", "must be a whole number, found 'x'"],
    ]


def test_files_are_told_in_their_order_with_all_that_is_wrong_in_each(check: Callable[..., Checked]) -> None:
    run = manifest(
        "  algorithmRef: {name: kiss-icp}\n  datasetRef: {name: hall}\n  seed: 1\n  seed: 2\n  timeout: 1d\n"
        "  parameters:\n    nope: 1\n    maxRange: .inf\n",
        "MappingRun",
        "S_",
    )
    dataset = manifest("  recording: {format: Bag}\n", "Dataset", "hall")
    checked = check(run + "---\nkind: [\n", dataset, manifest(TEMPLATE))
    assert [problem.split(": ")[0] for problem in checked.problems] == [
        *("a.yaml:3", "a.yaml:8", "a.yaml:9", "a.yaml:11", "a.yaml:12", "a.yaml:15"),
        "b.yaml:5",
    ]
    assert checked.problems[3].startswith("a.yaml:11: spec: parameters.nope: kiss-icp has no parameter")
    assert [sweep.name for sweep, _ in checked.plans] == ["s"]


def test_a_plan_of_settings_that_do_not_fit_is_made_and_says_so(check: Callable[..., Checked]) -> None:
    unknown = "  - {path: algorithm, values: [kiss-icp, somebody-elses]}\n"
    matrix = f"  matrix:\n{unknown}  - {{path: parameters.maxRange, values: [-1, 30]}}\n"
    checked = check(manifest(TEMPLATE + matrix), strict=False, misfits=True)
    assert [len(points) for _, points in checked.plans] == [4]
    assert not checked.problems
    (told,) = checked.misfits
    assert told.startswith("a.yaml:8: spec.matrix[1].values[0]: parameters.maxRange: -1 is below")


MISSPELT_AXIS = "  matrix: [{path: parameter.maxRange, values: [5]}]\n"
CAMERA = "  template: {spec: {datasetRef: {name: synthetic-camera}}}\n"


@pytest.mark.parametrize(
    ("body", "fields"),
    [
        ("  tempalte: {spec: {}}\n", ["spec.tempalte"]),
        (TEMPLATE.replace("algorithmRef", "algoritmRef"), ["spec.template.spec.algoritmRef"]),
        (
            TEMPLATE + "  matrix: [{path: sensors, vals: [lidar]}]\n  exclude: [{sensors: lidar}]\n",
            ["spec.matrix.0.vals"],
        ),
        (TEMPLATE + MISSPELT_AXIS + "  exclude: [{parameters.maxRange: 5}]\n", ["spec.matrix[0].path"]),
        (
            TEMPLATE + "  matrix: [{path: seed, values: [x]}]\n  exclude: [{seed: 1}]\n",
            ["spec.matrix[0].values[0]"],
        ),
        (CAMERA + "  matrix: [{path: algorthm, values: [orb-slam3]}]\n", ["spec.matrix[0].path"]),
        (
            TEMPLATE + "  matrix: [{path: seed, values: [1]}, 7, {path: seed, values: [x]}]\n",
            ["spec.matrix.1", "spec.matrix[2]"],
        ),
    ],
)
def test_what_only_follows_from_a_mistake_is_not_told(
    body: str, fields: list[str], check: Callable[..., Checked]
) -> None:
    checked = check(manifest(body))
    assert [problem.split(": ")[1] for problem in checked.problems] == fields
    assert checked.plans == []


def test_a_name_that_a_broken_manifest_has_is_not_unknown(check: Callable[..., Checked]) -> None:
    sweep = manifest(TEMPLATE.replace("synthetic-lidar", "hall"))
    assert len(check(sweep).problems) == 1
    for broken in (
        "kind: Dataset\nmetadata: {name: hall}\nspec: [\n",
        manifest("  x: 1\n", "Dataset", "hall"),
    ):
        checked = check(sweep, broken)
        assert {problem.split(":")[0] for problem in checked.problems} == {"b.yaml"}
    # A broken one in the place of one that is known by that name: nothing is judged by the known one.
    own = manifest("  modes: 3\n", "Algorithm", "kiss-icp")
    assert all(
        problem.startswith("b.yaml")
        for problem in check(
            manifest(TEMPLATE + "  matrix: [{path: parameters.own, values: [1]}]\n"), own
        ).problems
    )


def test_one_name_may_stand_once(check: Callable[..., Checked]) -> None:
    sweep = manifest(TEMPLATE)
    assert check(sweep, "\n" + sweep).problems == ["b.yaml:4: Sweep 's' stands in a.yaml:3 already"]


def test_a_file_that_can_not_be_read_leaves_the_others_judged(
    check: Callable[..., Checked], tmp_path: Path
) -> None:
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "a.yaml").write_text(manifest(TEMPLATE + "  repetitions: 0\n"), encoding="utf-8")
    paths = [tmp_path / name for name in ("absent.yaml", "a.yaml", "b.yaml")]
    found = check_files(paths, load_workshop()).problems
    assert [problem.removeprefix(f"{tmp_path}/").split(": ")[0] for problem in found] == [
        *("absent.yaml", "a.yaml:6", "b.yaml"),
    ]


def test_a_hundred_mistakes_are_told_one_by_one(check: Callable[..., Checked]) -> None:
    values = ", ".join(f"x{number}" for number in range(MOST + 23))
    checked = check(manifest(TEMPLATE + f"  matrix: [{{path: seed, values: [{values}]}}]\n"))
    with pytest.raises(InputError) as error:
        checked.refuse()
    lines = str(error.value).splitlines()
    assert (len(lines), lines[-1]) == (MOST + 1, "… and 23 more")


def test_names_that_are_not_known_yet_are_no_mistake_of_a_plan(check: Callable[..., Checked]) -> None:
    assert check(manifest(TEMPLATE.replace("kiss-icp", "mine")), strict=False).problems == []
