# SPDX-License-Identifier: Apache-2.0
"""Digests of container images, by which equal runs are known on a cluster and on a workstation alike."""

from __future__ import annotations


def image_digest(image_id: str) -> str:
    """Return the part of an imageID that names the image's content."""
    return image_id.rpartition("@")[2] if "@" in image_id else image_id


def pinned_digest(image: str) -> str | None:
    """Return the digest that an image's name carries, if it does."""
    name, at, digest = image.rpartition("@")
    return digest if at and name and digest.startswith("sha256:") else None
