# SPDX-License-Identifier: Apache-2.0
"""The page of a search in a browser, and its answer: on a desk and on a phone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from searched import fill_search, sweep_of
from slamhive.archive import Archive

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytestmark = pytest.mark.browser

PAGES = {"tune": "What matters to ATE", "front": "Front", "live": "To come: about"}


@pytest.fixture(scope="module")
def searches(serve: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a dashboard over a finished search, one of two objectives, and one under way."""
    home = tmp_path_factory.mktemp("searched")
    url = f"sqlite:///{home / 'archive.sqlite'}"
    with Archive.open(url) as archive:
        fill_search(archive, sweep_of("tune"), known=3)
        fill_search(archive, sweep_of("front", 2, 24))
        fill_search(archive, sweep_of("live"), most_runs=20)
    with serve(url, home / "log.txt") as address:
        yield address


@pytest.mark.parametrize("name", PAGES)
def test_the_page_of_a_search_shows_its_content_to_everyone(browser: Any, searches: str, name: str) -> None:
    browser.open(f"{searches}/sweeps/{name}")
    browser.wait(f"document.body.innerText.includes({PAGES[name]!r})")
    assert browser.run("document.querySelector('.fault')?.innerText ?? null") is None
    assert "why it was dropped" in browser.text()
    for width, dark in ((1280, False), (390, True)):
        browser.look(width=width, dark=dark)
        browser.wait("document.documentElement.scrollWidth <= innerWidth")
        assert browser.barriers() == []
