# SPDX-License-Identifier: Apache-2.0
"""Every page in a browser: what it shows, what its controls do; complaints of the browser are failures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.browser

DRAWN = "document.querySelectorAll('.canvas[data-drawn=yes] canvas').length"


@pytest.fixture(autouse=True)
def quiet(request: pytest.FixtureRequest, browser: Any) -> Iterator[None]:
    """After a test, nothing was written to the console that the test did not take away."""
    browser.call("Page.navigate", url="about:blank")
    browser.complaints.clear()
    yield
    browser.run("1")
    assert [one for one in browser.complaints if "ERR_NETWORK_CHANGED" not in one] == []


PAGES = {
    "/": "Overview",
    "/runs": "OutOfMemory",
    "/runs/run-000": "Configuration",
    "/runs/run-005": "Nothing was measured",
    "/explore": "Behind it",
    "/explore?kind=line&x=parameters.nFeatures&facet=dataset": "hall",
    "/explore?kind=box&x=algorithm&colour=dataset": "Behind it",
    "/explore?kind=heat&x=parameters.nFeatures": "Runs",
    "/explore?kind=parallel": "over",
    "/explore?kind=pareto&x=usage.cpu.meanCores": "nobody has both",
    "/leaderboard": "over the best",
    "/table?by=algorithm": "failures",
    "/compare?uid=run-000&uid=run-001": "outcome",
    "/algorithms": "first",
    "/algorithms/first": "Leaderboard",
    "/datasets": "Datasets",
}


@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)], ids=["desk", "phone"])
@pytest.mark.parametrize("path", PAGES)
def test_page_shows_its_content(browser: Any, site: str, path: str, width: int, dark: bool) -> None:
    browser.open(site + path, width=width, dark=dark)
    browser.wait(f"document.body.innerText.includes({PAGES[path]!r})")
    assert browser.run("document.querySelector('.fault')?.innerText ?? null") is None
    assert browser.run("document.documentElement.scrollWidth <= innerWidth"), (
        "the page is wider than the window"
    )


@pytest.mark.parametrize("path", PAGES)
def test_everything_has_a_name(browser: Any, site: str, path: str) -> None:
    browser.open(site + path)
    browser.wait(f"document.body.innerText.includes({PAGES[path]!r})")
    nameless = """[...document.querySelectorAll('button, a[href], select, input, [role=img], table')]
        .filter((one) => !(one.innerText?.trim() || one.ariaLabel || one.labels?.[0]?.textContent.trim()
            || one.querySelector('caption')?.textContent || one.querySelector('img')))
        .map((one) => one.outerHTML.slice(0, 200))"""
    assert browser.run(nameless) == []
    assert browser.run("document.querySelectorAll('h1').length") == 1


def test_markup_in_names_is_text(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs/run-005")
    assert "<b>run</b> 5" in browser.text()
    assert "<img src=x" in browser.text()
    assert browser.run("document.querySelectorAll('main img, h1 b').length") == 0


@pytest.mark.parametrize(
    ("path", "sentence", "place"),
    [
        ("/explore?x=parameters.nFeaturs", "did you mean 'parameters.nFeatures'", "label.wrong select"),
        ("/runs?where=" + quote("run == a ?"), "unexpected", ".filters .wrong input"),
        ("/runs?algorithn=first", "did you mean 'algorithm'", ".chip.wrong"),
        ("/runs?after=tampered", "page", ".fault"),
        ("/runs/no-such-run", "no-such-run", ".fault"),
    ],
)
def test_mistakes_are_shown_where_they_are(
    browser: Any, site: str, path: str, sentence: str, place: str
) -> None:
    browser.open(site + path)
    browser.wait(f"!!document.querySelector({place!r})")
    assert sentence in browser.run("document.querySelector('.fault').innerText")
    browser.complaints[:] = [one for one in browser.complaints if "status of 40" not in one]


def test_choices_are_kept_in_the_address(browser: Any, site: str) -> None:
    browser.open(f"{site}/explore")
    browser.choose("Draw", "line")
    browser.choose("x", "parameters.nFeatures")
    browser.choose("Condition", "coverage >= 0.9")
    browser.wait(f"{DRAWN} > 0 && location.search.includes('where')")
    browser.choose("Filter by", "algorithm")
    browser.choose("is", "first")
    browser.wait("location.search.includes('algorithm=first')")
    address = browser.run("location.href")
    browser.open(address)
    assert browser.run("document.querySelector('.chip').innerText").startswith("algorithm = first")
    assert browser.run("[...document.querySelectorAll('select')].map((one) => one.value)")[:2] == [
        "line",
        "parameters.nFeatures",
    ]
    browser.click(".chip button")
    browser.wait("!location.search.includes('algorithm=first')")


def test_runs_are_sorted_paged_and_compared(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs?limit=20")
    browser.click("th button", "ATE")
    browser.wait(
        "location.search.includes('sort=ate.rmse') && !!document.querySelector('th[aria-sort=ascending]')"
    )
    browser.click("a", "Next page")
    browser.wait("location.search.includes('after=') && document.body.innerText.includes('First page')")
    browser.click("td input")
    browser.click("a", "Compare 1 run")
    browser.wait("location.pathname === '/compare' && document.querySelectorAll('tbody tr').length === 1")


def test_a_chart_has_its_table_and_csv(browser: Any, site: str) -> None:
    browser.open(f"{site}/explore?kind=scatter&x=parameters.nFeatures&y=ate.rmse")
    browser.wait(f"{DRAWN} === 1")
    browser.click("figure button", "Table")
    browser.wait("document.querySelectorAll('figure tbody tr').length === 48")
    rows = browser.run("fetch(document.querySelector('figure a').href).then((answer) => answer.text())")
    assert len(rows.strip().splitlines()) == 49


def test_pictures_are_given(browser: Any, site: str) -> None:
    browser.open(f"{site}/explore?kind=line&x=parameters.nFeatures")
    browser.wait(f"{DRAWN} >= 1")
    browser.run("""window.kept = [];
        HTMLAnchorElement.prototype.click = function () { kept.push([this.download, this.href]); };
        for (const name of ['PNG', 'SVG'])
            [...document.querySelectorAll('figure button')].find((one) => one.innerText === name).click();""")
    browser.wait("kept.length === 2")
    kept = dict(browser.run("kept.map(([name, href]) => [name.split('.').at(-1), href])"))
    assert kept["png"].startswith("data:image/png")
    assert kept["svg"].startswith("blob:")


def test_theme_is_turned_and_kept(browser: Any, site: str) -> None:
    browser.open(f"{site}/")
    before = browser.run("getComputedStyle(document.body).backgroundColor")
    browser.click("header button", "Dark")
    assert browser.run("getComputedStyle(document.body).backgroundColor") != before
    browser.open(f"{site}/explore")
    assert browser.run("document.documentElement.dataset.theme") == "dark"
    browser.run("localStorage.clear()")


def test_embedded_page_is_the_chart_alone(browser: Any, site: str) -> None:
    browser.open(f"{site}/explore?embed=1&kind=scatter&x=parameters.nFeatures")
    browser.wait(f"{DRAWN} === 1")
    assert browser.run("document.querySelectorAll('header, .filters, .controls').length") == 0


def test_empty_archive_says_what_to_do(browser: Any, empty_site: str) -> None:
    browser.open(f"{empty_site}/")
    browser.wait("document.body.innerText.includes('slamhive import')")
    browser.call("Page.navigate", url="about:blank")
