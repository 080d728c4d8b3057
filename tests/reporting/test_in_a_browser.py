# SPDX-License-Identifier: Apache-2.0
"""The report as a browser shows it: no complaint, no request, light and dark, on a telephone."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any

import pytest

from browsers import poll
from slamhive.analysis import Outcomes, Selection, choose
from slamhive.reporting.page import ReportContents, report_html
from slamhive.reporting.questions import usual_questions
from slamhive.tables.reading import archive_url, read_archive

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.browser

BACKGROUND = "getComputedStyle(document.body).backgroundColor"
BLOCKED = "performance.getEntriesByType('resource').filter((one) => !one.name.startsWith('data:')).length"


@pytest.fixture
def address(assorted: Path) -> str:
    frame = choose(read_archive(archive_url(assorted)), Selection()).frame
    questions = tuple(usual_questions(frame, "ate.rmse", Outcomes.TRACKED))
    file = assorted / "report.html"
    file.write_text(report_html(frame, ReportContents(questions=questions)), encoding="utf-8")
    return file.as_uri()


def test_light_dark_and_small(browser: Any, address: str) -> None:
    seen = {}
    for name, options in (("light", {}), ("dark", {"dark": True}), ("phone", {"width": 360})):
        browser.open(address, **options)
        assert browser.complaints == []
        assert browser.run(BLOCKED) == 0
        assert browser.run("document.documentElement.scrollWidth <= innerWidth"), name
        assert name == "phone" or browser.barriers() == []
        seen[name] = browser.run(BACKGROUND)
    assert seen["light"] == seen["phone"] == "rgb(255, 255, 255)"
    assert seen["dark"] != seen["light"]


def test_colours_and_marks_are_drawn(browser: Any, address: str) -> None:
    browser.open(address)
    mark = "document.querySelector('svg[role=img] .mark')"
    assert browser.run(f"getComputedStyle({mark}).fill") == "rgb(0, 114, 178)"
    boxes = browser.run(
        "[...document.querySelectorAll('svg[role=img]')].map((svg) => [svg.getBBox(), svg.viewBox.baseVal])"
        ".map((pair) => pair.map((box) => [box.x, box.y, box.x + box.width, box.y + box.height]))"
    )
    assert boxes
    for (left, top, right, bottom), (x, y, width, height) in boxes:
        assert left >= x - 1
        assert top >= y - 1
        assert right <= width + 1
        assert bottom <= height + 1


def test_a_table_can_be_saved(browser: Any, address: str, tmp_path: Path) -> None:
    browser.open(address)
    folder = tmp_path / "saved"
    folder.mkdir()
    browser.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
    expected = browser.run("document.querySelector('a[download=\"runs.csv\"]').href")
    browser.click('a[download="runs.csv"]')
    browser.wait("true")
    saved = folder / "runs.csv"
    poll(lambda: saved.exists() and saved.stat().st_size, "the file")
    assert saved.read_bytes() == base64.b64decode(expected.partition("base64,")[2])


def test_on_paper_it_is_light(browser: Any, address: str) -> None:
    browser.open(address, dark=True)
    browser.call("Emulation.setEmulatedMedia", media="print")
    try:
        assert browser.run(BACKGROUND) == "rgb(255, 255, 255)"
        assert browser.run("getComputedStyle(document.querySelector('nav')).display") == "none"
    finally:
        browser.call("Emulation.setEmulatedMedia", media="")
