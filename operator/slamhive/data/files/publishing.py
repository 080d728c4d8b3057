# SPDX-License-Identifier: Apache-2.0
"""Publishing of an imported dataset: its folder with recording and manifest appears whole or not at all.

All importers of recordings use it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml

from slamhive.data.files.once import make_once
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError
from slamhive.model.loading import parse, to_object

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

MANIFEST = "dataset.yaml"


def publish(out: Path, manifest: Mapping[str, Any], make: Callable[[Path], None]) -> Dataset:
    """Make a dataset's folder.

    Args:
        out: The folder to make.
        manifest: The Dataset as plain values; absent fields may be None.
        make: Writes the files that the manifest names into a folder.

    Returns:
        The dataset.

    Raises:
        InputError: The folder exists, or the manifest doesn't follow the language.
    """
    if out.exists():
        raise InputError(f"{out}: exists already; choose another folder or remove it")
    text = yaml.safe_dump(_present(manifest), sort_keys=False, allow_unicode=True, width=110)
    dataset = to_object(parse(text, str(out / MANIFEST))[0])
    if not isinstance(dataset, Dataset):
        raise InputError(f"{out / MANIFEST}: not a Dataset")

    def fill(aside: Path) -> None:
        make(aside)
        (aside / MANIFEST).write_text(text, encoding="utf-8")

    make_once(out, fill)
    return dataset


def _present(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _present(item) for key, item in value.items() if item is not None}
    return value
