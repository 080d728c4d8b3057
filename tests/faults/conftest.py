# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the fault tests: the import path of the injector's modules, and the injector."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from injecting import Injector

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def injector(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Injector]:
    """Runs commands with faults."""
    from injecting import Injector, compiler

    if compiler() is None:
        pytest.skip("needs a C compiler: sudo apt-get install gcc libc6-dev")
    with Injector(tmp_path_factory.mktemp("injector")) as found:
        yield found
