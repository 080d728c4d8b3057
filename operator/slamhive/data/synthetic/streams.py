# SPDX-License-Identifier: Apache-2.0
"""Random numbers by purpose: adding a sensor to a recording changes none of the others' noise."""

from __future__ import annotations

import zlib

import numpy as np


def stream(seed: int, purpose: str, index: int = 0) -> np.random.Generator:
    """Open the random stream of one purpose.

    Args:
        seed: The recording's seed.
        purpose: What the numbers are for; different purposes are independent.
        index: Distinguishes messages, so that each can be made without those before it.
    """
    return np.random.default_rng([seed, zlib.crc32(purpose.encode()), index])
