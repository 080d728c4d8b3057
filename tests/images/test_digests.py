# SPDX-License-Identifier: Apache-2.0
"""images/build --digests: what a registry answers stands in the Dockerfiles, or nothing is written."""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, ClassVar

import pytest
from building import base, digests
from building.errors import BuildError
from building.recipes import Recipe

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

DIGEST = "sha256:" + "5a" * 32


class Registry(BaseHTTPRequestHandler):
    """Knows debian:bookworm-slim, and python:1 with a digest that is none."""

    known: ClassVar = {
        "/v2/library/debian/manifests/bookworm-slim": DIGEST,
        "/v2/library/python/manifests/1": "md5:1",
    }

    def do_HEAD(self) -> None:
        found = self.known.get(self.path)
        self.send_response(200 if found and "image.index" in self.headers["Accept"] else 404)
        self.send_header("Docker-Content-Digest", found or "")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


@pytest.fixture
def registry() -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Registry) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.fixture
def recipe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Recipe:
    dockerfile = tmp_path / "Dockerfile"
    dockerfile.write_text("ARG BASE=debian:bookworm-slim\nFROM ${BASE}\n")
    monkeypatch.setattr(digests, "UNPINNED", tmp_path / "unpinned.txt")
    digests.UNPINNED.write_text("# Why.\ndebian:bookworm-slim  not asked yet\nother:1  gone\n")
    return Recipe("thing", "slamhive/thing:1.0", dockerfile, tmp_path, "A thing.", "MIT")


def test_a_digest_is_written_and_needs_no_reason_any_more(
    recipe: Recipe, registry: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = digests.digest_of
    monkeypatch.setattr(digests, "digest_of", lambda name: asked(name, registry))
    for _ in range(2):  # a digest gives way to the next
        assert digests.write_digests([recipe]) == {"debian:bookworm-slim": DIGEST}
        assert recipe.default_base == f"debian:bookworm-slim@{DIGEST}"
        assert digests.unpinned() == {"other:1": "gone"}
    assert base._exact(recipe.default_base) == f"debian@{DIGEST}"


@pytest.mark.parametrize(
    ("name", "why"), [("debian:none", "HTTP Error 404"), ("python:1", "answers 'md5:1' for python:1")]
)
def test_what_a_registry_does_not_tell_is_said(registry: str, name: str, why: str) -> None:
    with pytest.raises(BuildError, match=why):
        digests.digest_of(name, registry)


def test_nothing_is_written_when_no_registry_answers(recipe: Recipe, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(name: str) -> str:
        raise BuildError(name)

    monkeypatch.setattr(digests, "digest_of", fail)
    before = recipe.dockerfile.read_text()
    with pytest.raises(BuildError):
        digests.write_digests([recipe])
    assert recipe.dockerfile.read_text() == before
