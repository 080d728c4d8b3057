# SPDX-License-Identifier: Apache-2.0
"""A disk that fails at any write of a sweep: a sentence, nothing lost, nothing twice, the same results.

More: ``python tests/faults/inject.py --faults 200``.
"""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest
from injecting import Fault
from scene import Scene

from thinning import thinned

if TYPE_CHECKING:
    from collections.abc import Iterator

    from injecting import Injector

FAULTS = (
    Fault(1, "ENOSPC", call="write", form="archive.sqlite*"),
    Fault(20, "EIO", call="write", form=".archive.sqlite.*.making"),
    Fault(9, "short", call="write", form="archive.sqlite-wal"),
    Fault(5, "EIO", call="fsync", form="archive.sqlite-wal"),
    Fault(40, "ENOSPC", lasting=True, call="write", form="archive.sqlite-wal"),
    Fault(1, "ENOSPC", call="create", form="datasets/.tiny-*.lock"),
    Fault(1, "EDQUOT", call="rename", form="datasets/.tiny-*.making/recording.bag"),
    Fault(1, "EIO", call="write", form="datasets/.tiny-*.making/*/groundtruth.txt"),
    Fault(1, "ENOSPC", call="write", form="variants/.hashes/*"),
    Fault(3, "ENOSPC", lasting=True, call="write", form="variants/.*.making/recording.bag"),
    Fault(2, "short", call="write", form="variants/.*.making/recording.bag"),
    Fault(1, "EROFS", call="create", form="variants/.*.making/variant.json"),
    Fault(1, "ENOSPC", call="write", form="runs/faulty/*/attempt.json"),
    Fault(1, "EIO", call="rename", form="runs/faulty/*/process.json"),
    Fault(1, "ENOSPC", call="write", form="runs/faulty/*/usage.csv"),
    Fault(1, "short", call="write", form="runs/faulty/*/summary.json.*.tmp"),
    Fault(1, "EIO", call="fsync", form="runs/faulty/*/summary.json.*.tmp"),
    Fault(1, "EIO", call="rename", form="runs/faulty/*/run/output/usage.csv"),
    Fault(1, "EROFS", call="mkdir", form="truths"),
    Fault(200, "EROFS", lasting=True),
)


@pytest.fixture(scope="module")
def scene(injector: Injector, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    folder = tmp_path_factory.mktemp("scene")
    yield Scene(folder, injector)
    shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("fault", thinned(FAULTS), ids=str)
def test_a_fault_at_any_write_loses_nothing(scene: Scene, fault: Fault) -> None:
    outcome = scene.inject(fault)
    assert outcome.made, "nothing failed: is the file called otherwise now?"
    assert outcome.wrong == (), outcome.first.err
