# SPDX-License-Identifier: Apache-2.0
"""Earlier versions on the pages: left out until the switch is on, counted, compared with what came after."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive, SweepRecord
from slamhive.model.results import Provenance

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from slamhive.model.results import RunRecord

pytestmark = pytest.mark.browser

RUNS = 24
STUDY = "/sweeps/study?namespace="
ALL_VERSIONS = "superseded=1"


def edited(make_run: Callable[[int], RunRecord], version: int) -> list[RunRecord]:
    """Return the runs of a version of the sweep; the second one's algorithm has twice the error."""
    runs = []
    for number in range(RUNS):
        run = make_run(2 * number)
        (result,) = run.results
        rmse = result.values["ate"]["rmse"] * version * (1 + number / 1000)
        values = result.values | {"ate": {"rmse": rmse}}
        runs.append(
            run.replace(
                uid=f"v{version}-{number}",
                name=f"run-{version}-{number}",
                sweep_uid=f"study-{version}",
                created=datetime(2026, version, 1, tzinfo=UTC) + timedelta(minutes=number),
                results=[result.replace(values=values)],
                folder=None,
                provenance=Provenance(algorithm_hash=f"hash-{version}", content_hash=f"{version}-{number}"),
            )
        )
    return runs


@pytest.fixture(scope="module")
def site(
    serve: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory, make_run: Callable[[int], RunRecord]
) -> Iterator[str]:
    """The address of a dashboard over a sweep that was edited, and another of its name on a cluster."""
    folder = tmp_path_factory.mktemp("edited")
    url = f"sqlite:///{folder / 'archive.sqlite'}"
    with Archive.open(url) as archive:
        for version in (1, 2):
            created = datetime(2026, version, 1, tzinfo=UTC)
            archive.put_sweep(SweepRecord(uid=f"study-{version}", name="study", spec={}, created=created))
            archive.put_runs(edited(make_run, version))
        archive.put_sweep(SweepRecord(uid="lab", name="study", spec={}, namespace="lab", cluster="big"))
        lab = make_run(1).replace(sweep_uid="lab", namespace="lab", cluster="big", uid="lab-1")
        archive.put_run(lab)
    with serve(url, folder / "log.txt") as address:
        yield address


def leave(browser: Any) -> None:
    browser.call("Page.navigate", url="about:blank")


def test_the_switch_takes_earlier_versions_in_and_stays_in_the_address(browser: Any, site: str) -> None:
    browser.open(f"{site}/leaderboard")
    browser.wait(
        "document.querySelector('.notes')?.innerText.includes('24 runs of earlier versions left out')"
    )
    browser.click(".filters label", "earlier versions too")
    browser.wait(f"location.search.includes({ALL_VERSIONS!r})")
    browser.wait("!document.body.innerText.includes('earlier versions left out')")
    ranked = "[...document.querySelectorAll('tbody tr')].filter((one) => one.innerText.includes('first'))"
    browser.wait(f"{ranked}.length === 2")
    assert browser.run("document.querySelectorAll('.chip').length") == 0
    assert browser.barriers() == []
    browser.open(f"{site}/runs?{ALL_VERSIONS}&limit=10")
    browser.wait("document.querySelector('h1')?.innerText.includes('49')")
    assert browser.run("document.querySelector('.filters [type=checkbox]').checked")
    browser.click(".filters label", "earlier versions too")
    browser.wait("document.querySelector('h1')?.innerText.includes('25')")
    leave(browser)


@pytest.mark.parametrize(
    "path", ["/runs", "/table?by=algorithm", "/explore?kind=scatter&x=run", "/explore?kind=line", "/studies"]
)
def test_what_is_left_out_is_said_on_every_page(browser: Any, site: str, path: str) -> None:
    browser.open(f"{site}{path}")
    browser.wait(
        "[...document.querySelectorAll('.notes')].some((one) =>"
        " one.innerText.includes('earlier versions left out'))"
    )
    leave(browser)


def test_versions_of_a_sweep_are_one_card_and_namespaces_are_two(browser: Any, site: str) -> None:
    browser.open(f"{site}/")
    browser.wait("document.querySelectorAll('article').length === 2")
    cards = browser.run("[...document.querySelectorAll('article')].map((one) => one.innerText)")
    (here,) = (text for text in cards if "2 versions, 24 superseded runs" in text)
    (lab,) = (text for text in cards if "in lab" in text)
    assert "24 of 24 runs finished" in here
    assert "1 of 1 runs finished" in lab
    # Each comes with an answer of its own.
    browser.wait(r"/sweeps\s+2\s/.test(document.body.innerText)")
    browser.wait("document.body.innerText.includes('24 runs of earlier versions are left out here')")
    browser.click("article a", "24 superseded runs")
    browser.wait("document.querySelector('h1')?.innerText.includes('24')")
    browser.wait("location.pathname === '/runs'")
    leave(browser)


def test_a_sweep_leads_to_what_changed(browser: Any, site: str) -> None:
    browser.open(f"{site}{STUDY}")
    browser.wait("document.body.innerText.includes('Points 24')")
    browser.click(".card a", "Before and after")
    browser.wait("document.body.innerText.includes('after is 2 times worse, in 8 of 8 settings: more than')")
    browser.wait("document.querySelectorAll('.canvas[data-drawn=yes]').length === 1")
    assert "Tested by sign flips over settings" in browser.text()
    assert not browser.run("!!document.querySelector('.filters [type=checkbox]')")
    for width, dark in ((1280, False), (390, True)):
        browser.look(width=width, dark=dark)
        browser.wait("document.documentElement.scrollWidth <= innerWidth")
        assert browser.barriers() == []
    browser.choose("Measured by", "usage.memory.peakBytes")
    browser.wait("document.body.innerText.includes('after is the same in 8 of 8 settings')")
    leave(browser)


def test_a_sweep_of_another_namespace_is_another_one(browser: Any, site: str) -> None:
    browser.open(f"{site}/sweeps")
    browser.click("article a", "study")
    browser.wait("location.pathname === '/sweeps/study' && document.body.innerText.includes('Points')")
    browser.open(f"{site}/sweeps/study?namespace=lab")
    browser.wait("document.body.innerText.includes('Points 1')")
    assert "in lab" in browser.run("document.querySelector('h1').innerText")
    assert "superseded" not in browser.text()
    leave(browser)
