# SPDX-License-Identifier: Apache-2.0
"""A disk that fills up leaves nothing half written in the catalog of a home."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.data.store.datasets import add_dataset
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.folder import Home
from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.model.dataset import Dataset


def test_a_full_disk_leaves_no_half_a_manifest(
    home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset: Dataset = load_file(home.path / "tiny.yaml")[0]  # type: ignore[assignment]
    other = Home.at(tmp_path / "other")
    write = type(tmp_path).write_text

    def fill(path: Path, text: str, **options: str) -> None:
        write(path, text[:20], **options)
        raise OSError(28, "No space left on device", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(type(tmp_path), "write_text", fill)
        with pytest.raises(OSError, match="No space"):
            add_dataset(dataset, tmp_path, other.path / "datasets")
    assert "tiny" not in load_workshop(other).datasets
    add_dataset(dataset, tmp_path, other.path / "datasets")
    assert "tiny" in load_workshop(other).datasets
