# SPDX-License-Identifier: Apache-2.0
"""Everything that the documents show is true: links, manifests, what a matrix expands to, commands.

A fenced block is ``sh`` (each line is run), ``yaml`` (loaded), ``python``, ``mermaid`` or ``text``. A first
line ``# FILE`` makes it a file of that name for the commands. A ``yaml`` block without a kind is part of a
Sweep's spec, and its first line says how many runs it has.
"""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import pytest
import yaml
from documents import DOCUMENTS, ROOT, blocks, name_of, prose

from slamhive.archive import Archive
from slamhive.cli.parts.checked import check_files
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.folder import Home
from slamhive.model.configuration import RunConfiguration
from slamhive.model.loading import parse
from slamhive.model.run import MappingRun
from slamhive.model.sweep import RunTemplate, Sweep, SweepSpec
from slamhive.plan import Plan, plan_problems

if TYPE_CHECKING:
    from collections.abc import Callable

LANGUAGES = {"bash", "sh", "yaml", "python", "mermaid", "text", "sql", "diff", "js"}
LINK = re.compile(r"(?<!!)\[[^\]]+\]\(([^)\s]+)\)")
TEMPLATE = {"algorithmRef": {"name": "kiss-icp"}, "datasetRef": {"name": "synthetic-lidar"}}

ELSEWHERE = {
    "algorithm train-vocabulary": "takes minutes, and has its own tests",
}
"""Commands that are not run here, and why."""
SMALLER = {"dim.yaml": ("rate: 5,", "rate: 1,")}
"""Texts in files of the documents, and others that make them quicker to render."""
BEFORE = {"home.md": "README.md", "results.md": "README.md"}
"""Documents whose commands ask for what those of another one made."""


def commands(document: Path) -> list[str]:
    lines = [line for block in blocks(document, "sh") for line in block.text.splitlines()]
    return [line for line in lines if shlex.split(line, comments=True)]


def lay_out(document: Path, folder: Path) -> None:
    for block in blocks(document):
        if block.file:
            stated, smaller = SMALLER.get(block.file, ("", ""))
            assert stated in block.text
            (folder / block.file).parent.mkdir(parents=True, exist_ok=True)
            (folder / block.file).write_text(block.text.replace(stated, smaller) if stated else block.text)


def slug(heading: str) -> str:
    """Return the anchor that GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_fences_say_what_they_are(document: Path) -> None:
    assert document.read_text().count("```") % 2 == 0
    assert {block.language for block in blocks(document)} <= LANGUAGES


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_links_lead_somewhere(document: Path) -> None:
    text = prose(document)
    for target in LINK.findall(text):
        if target.startswith("https://"):
            continue
        path, _, anchor = target.partition("#")
        place = (document.parent / path).resolve() if path else document
        assert place.is_relative_to(ROOT)
        assert place.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.+)$", prose(place), re.MULTILINE)
            assert anchor in map(slug, headings), target


def test_every_decision_is_in_the_index() -> None:
    folder = ROOT / "docs" / "decisions"
    listed = re.findall(r"\]\((\d[\w-]+\.md)\)", (folder / "index.md").read_text())
    assert listed == sorted(path.name for path in folder.glob("0*.md"))


def test_every_marker_is_explained() -> None:
    options = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    explained = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs/develop/testing.md").read_text(), re.MULTILINE)
    assert explained == [marker.partition(":")[0] for marker in options["markers"]]


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_manifests_are_valid(document: Path, tmp_path: Path) -> None:
    files = []
    for number, block in enumerate(blocks(document, "yaml")):
        value = next(yaml.safe_load_all(block.text))
        if value.get("kind") == "RunConfiguration":
            RunConfiguration.model_validate(value)
        elif "kind" in value:
            files.append(tmp_path / f"{number}.yaml")
            files[-1].write_text(block.text)
    workshop = load_workshop()
    checked = check_files(files, workshop)
    checked.refuse()
    for item in checked.objects:
        if isinstance(item, Sweep):
            assert plan_problems(Plan(item, workshop)) == []
        elif isinstance(item, MappingRun):
            spec = item.spec.model_dump(mode="json", by_alias=True, exclude_unset=True)
            single = Sweep(metadata=item.metadata, spec=SweepSpec(template=RunTemplate(spec=spec)))
            assert plan_problems(Plan(single, workshop)) == []


PAGES = sorted((ROOT / "docs" / "algorithms").glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_page_of_a_system_has_a_sweep_that_names_the_mode(page: Path) -> None:
    written = [next(yaml.safe_load_all(block.text)) for block in blocks(page, "yaml")]
    specs = [one["spec"]["template"]["spec"] for one in written if one.get("kind") == "Sweep"]
    assert [spec["algorithmRef"]["name"] for spec in specs] == [page.stem], f"a Sweep of {page.stem}"
    modes = load_workshop().algorithm(page.stem).algorithm.spec.modes
    assert specs[0]["sensors"] in [mode.name for mode in modes]


def parts_of_sweeps() -> list[Any]:
    parts = [
        pytest.param(block.text, id=f"{document.name}-{number}")
        for document in DOCUMENTS
        for number, block in enumerate(blocks(document, "yaml"))
        if "kind" not in next(yaml.safe_load_all(block.text))
    ]
    assert parts
    return parts


@pytest.mark.parametrize("text", parts_of_sweeps())
def test_parts_of_a_sweep_expand_to_what_they_say(text: str) -> None:
    stated = re.search(r"# (\d+) runs?$", text.split("\n", 1)[0])
    assert stated, "the first line says how many runs there are"
    fields = parse(text, "part")[0].value
    sweep = Sweep.model_validate(
        {"metadata": {"name": "part"}, "spec": {"template": {"spec": TEMPLATE}, **fields}}
    )
    plan = Plan(sweep, load_workshop())
    assert plan_problems(plan) == []
    assert len(plan) == int(stated.group(1))


def test_the_table_of_include_and_exclude() -> None:
    document = ROOT / "docs" / "sweeps.md"
    (block,) = (one for one in blocks(document, "yaml") if "\nexclude:" in one.text)
    sweep = {
        "metadata": {"name": "part"},
        "spec": {"template": {"spec": TEMPLATE}, **yaml.safe_load(block.text)},
    }
    plan = Plan(Sweep.model_validate(sweep), load_workshop())
    table = document.read_text().split("| index | maxRange |")[1].split("\n\n")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]
    shown = {int(row[0]): row[1:5] for row in rows if row[0]}
    assert len(rows) == len(plan) + 1
    for point in plan:
        names = ("parameters.maxRange", "input.frameRate", "parameters.deskew", "parameters.voxelSize")
        found = [str(point.coordinates.get(name, "")).lower() for name in names]
        assert shown[point.index] == found


def run(line: str, slamhive: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> None:
    """Run a command as it stands in a document; a number in its comment is what it prints."""
    program, *rest = shlex.split(line, comments=True)
    if program == "make":
        assert re.search(rf"^{rest[0]}:", (ROOT / "Makefile").read_text(), re.MULTILINE)
        return
    if rest[:2] == ["-m", "http.server"]:
        return  # it serves until somebody ends it
    assert program.removeprefix(".venv/bin/") == "slamhive", line
    if " ".join(rest[:2]) in ELSEWHERE:
        rest.append("--help")
    elif rest[:2] == ["import", "slam-hive"] and not Path("runs").exists():
        pytest.skip("the published runs are not here (../shared/data/icra2023)")
    capsys.readouterr()
    code, printed = slamhive(*rest), capsys.readouterr()
    assert code == 0, f"{line}\n{printed.out}{printed.err}"
    stated = re.search(r"# (\d+)$", line)
    assert stated is None or printed.out.strip() == stated.group(1), line


def the_example_is_right(home: Path) -> None:
    """Dead reckoning without noise is exact but for the integration's steps."""
    with Archive.open(Home.at(home).archive_url) as archive:
        errors = {
            record.spec["datasetRef"]["name"]: record.results[0].values["ate"]["rmse"]
            for record in archive.runs(sweep="reckon")
        }
        paths = {record.results[0].values["pathLength"] for record in archive.runs(sweep="reckon")}
    assert errors["perfect"] < 0.002 * max(paths)
    assert errors["perfect"] < 0.1 * errors["synthetic-lidar"]


def the_settings_are_read(_home: Path) -> None:
    """OpenCV reads the files that were rendered, as VINS does."""
    settings = cv2.FileStorage("rendered/vins.yaml", cv2.FILE_STORAGE_READ)
    assert settings.getNode("body_T_cam0").mat().shape == (4, 4)
    assert (settings.getNode("num_of_cam").real(), settings.getNode("max_cnt").real()) == (1, 150)
    camera = cv2.FileStorage("rendered/cam0.yaml", cv2.FILE_STORAGE_READ)
    assert camera.getNode("image_width").real() == settings.getNode("image_width").real() == 64


AFTER = {"algorithms.md": the_example_is_right, "settings-files.md": the_settings_are_read}
"""Checks of what else is to hold when a document's commands have been run."""


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "document",
    [
        # Those that users begin with run whole sweeps.
        pytest.param(one, id=one.name, marks=[pytest.mark.slow] if one.parent == ROOT / "docs" else [])
        for one in filter(commands, DOCUMENTS)
        # Those that come before another one are run with it.
        if one.relative_to(ROOT).as_posix() not in BEFORE.values()
    ],
)
def test_commands_do_what_the_document_says(
    document: Path, desk: Path, slamhive: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    order = [document]
    if document.name in BEFORE:
        order.insert(0, ROOT / BEFORE[document.name])
    for one in order:
        lay_out(one, desk)
        for line in commands(one):
            run(line, slamhive, capsys)
    if document.name in AFTER:
        AFTER[document.name](desk.parent / "home")


EXAMPLES = [path for path in sorted((ROOT / "examples").rglob("*.yaml")) if path.stem != "icra2023-80000"]
"""All but the one with algorithms that the catalog hasn't, which the tests of plans count."""


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_valid(path: Path) -> None:
    checked = check_files([path], load_workshop())
    checked.refuse()
