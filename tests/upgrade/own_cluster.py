# SPDX-License-Identifier: Apache-2.0
"""A cluster for one test alone: its kinds are those of an earlier version, which no other test could bear."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "cluster"))

from testcluster import choice
from testcluster.local import Local

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def own_cluster() -> Iterator[Local]:
    """Have a control plane of one's own, never the one that other tests share."""
    chosen = choice.choose()
    if chosen.mode != "local":
        pytest.skip(f"needs a local cluster of its own: {chosen.sentence()}")
    reading, writing = os.pipe()
    ours = Local.named(f"upgrade{os.getpid()}")
    try:
        ours.up(node=False, owner=reading)
        yield ours
    finally:
        ours.down()
        os.close(reading)
        os.close(writing)
