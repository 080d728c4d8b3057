# SPDX-License-Identifier: Apache-2.0
"""The docs site: it is built without a warning, fetches nothing, and has all that is public."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import slamhive_eval

pytestmark = pytest.mark.slow  # what is wrong with the site, `make docs` says

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the site, as ``make docs`` builds it."""
    pytest.importorskip("mkdocs", reason="no mkdocs here: make install")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return folder


def test_every_public_name_of_the_evaluator_is_explained(site: Path) -> None:
    text = (site / "api" / "evaluator.html").read_text()
    described = set(re.findall(r'id="slamhive_eval\.(?:\w+\.)?(\w+)"', text))
    assert set(slamhive_eval.__all__) - described == set()


def test_the_language_and_the_records_are_explained(site: Path) -> None:
    assert "Evenly spaced values." in (site / "api" / "language.html").read_text()
    assert 'id="slamhive.model.results.RunRecord"' in (site / "api" / "records.html").read_text()
    assert 'id="slamhive.results"' in (site / "api" / "results.html").read_text()


def test_pages_fetch_nothing_from_elsewhere(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        text = page.read_text()
        fetched = re.findall(r"<(?:script|img|iframe|source)\b[^>]*\bsrc=[\"']?(?:https?:)?//[^\"'> ]+", text)
        fetched += re.findall(r"<link\b[^>]*\brel=[\"']?(?:stylesheet|preconnect|preload)[^>]*//[^>]*>", text)
        fetched += re.findall(r'class="mermaid"', text)  # its renderer would come from another server
        assert fetched == [], page
