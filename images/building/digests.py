# SPDX-License-Identifier: Apache-2.0
"""Digests of base images: asked of the registry and written into the Dockerfiles, so that no tag is trusted.

Where a base has no digest yet, `images/unpinned-bases.txt` says why.
"""

from __future__ import annotations

import json
import re
import urllib.error
import urllib.parse
import urllib.request
from typing import TYPE_CHECKING

from building.errors import BuildError
from building.recipes import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from building.recipes import Recipe

REGISTRY = "https://registry-1.docker.io"
UNPINNED = ROOT / "images" / "unpinned-bases.txt"
_MANIFESTS = (
    "application/vnd.oci.image.index.v1+json, application/vnd.docker.distribution.manifest.list.v2+json"
)
_SECONDS = 30


def unpinned() -> dict[str, str]:
    """Return the reason of each base without a digest, by name and tag."""
    lines = [line for line in UNPINNED.read_text().splitlines() if line and not line.startswith("#")]
    return {name: reason.strip() for name, _, reason in (line.partition(" ") for line in lines)}


def write_digests(recipes: Iterable[Recipe]) -> dict[str, str]:
    """Write today's digest of each base into the Dockerfiles, and return them by name and tag.

    Raises:
        BuildError: the registry can't be asked; nothing has been written.
    """
    chosen = list(recipes)
    names = sorted({recipe.default_base.partition("@")[0] for recipe in chosen})
    found = {name: digest_of(name) for name in names}
    for path in {recipe.dockerfile for recipe in chosen}:
        path.write_text(_pinned(path.read_text(), found))
    comments = [line for line in UNPINNED.read_text().splitlines() if line.startswith("#")]
    left = [f"{name}  {reason}" for name, reason in unpinned().items() if name not in found]
    UNPINNED.write_text("\n".join([*comments, *left]) + "\n")
    return found


def _pinned(text: str, digests: Mapping[str, str]) -> str:
    def line(match: re.Match[str]) -> str:
        name = match[1].partition("@")[0]
        return f"ARG BASE={name}@{digests[name]}"

    return re.sub(r"^ARG BASE=(\S+)$", line, text, flags=re.MULTILINE)


def digest_of(name: str, registry: str = REGISTRY) -> str:
    """Return the digest of an official image's list of platforms.

    Args:
        name: name and tag, such as `debian:bookworm-slim`.
        registry: its registry.

    Raises:
        BuildError: the registry can't be reached or doesn't have it.
    """
    repository, _, tag = name.partition(":")
    address = f"{registry}/v2/library/{repository}/manifests/{tag}"
    headers = {"Accept": _MANIFESTS}
    try:
        try:
            answer = _head(address, headers)
        except urllib.error.HTTPError as error:
            if error.code != 401:
                raise
            token = _token(error.headers.get("WWW-Authenticate", ""))
            answer = _head(address, headers | {"Authorization": f"Bearer {token}"})
    except (OSError, ValueError, KeyError) as error:
        raise BuildError(f"the digest of {name} can't be had from {registry}: {error}") from None
    if not re.fullmatch(r"sha256:[0-9a-f]{64}", answer):
        raise BuildError(f"{registry} answers {answer[:100]!r} for {name}, expected sha256: and 64 digits")
    return answer


def _head(address: str, headers: Mapping[str, str]) -> str:
    request = urllib.request.Request(address, method="HEAD", headers=dict(headers))  # noqa: S310 - our registry
    with urllib.request.urlopen(request, timeout=_SECONDS) as answer:  # noqa: S310
        return str(answer.headers.get("Docker-Content-Digest", ""))


def _token(challenge: str) -> str:
    """Return an anonymous token, as the challenge `Bearer realm="…",service="…",scope="…"` tells to."""
    fields = dict(re.findall(r'(\w+)="([^"]*)"', challenge))
    realm = fields.pop("realm")
    if not realm.startswith("https://"):
        raise ValueError(f"it sends to {realm[:100]} for a token")
    address = f"{realm}?{urllib.parse.urlencode(fields)}"
    with urllib.request.urlopen(address, timeout=_SECONDS) as answer:  # noqa: S310
        return str(json.load(answer)["token"])
