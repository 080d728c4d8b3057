# SPDX-License-Identifier: Apache-2.0
"""Cases of a test that are alike: the quick tests take each third of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterable


def thinned(cases: Iterable[Any]) -> list[Any]:
    """Return a test's cases, of which two in three are slow; tuples are several arguments."""
    return [
        pytest.param(
            *(case if isinstance(case, tuple) else [case]), marks=[pytest.mark.slow] if k % 3 else []
        )
        for k, case in enumerate(cases)
    ]
