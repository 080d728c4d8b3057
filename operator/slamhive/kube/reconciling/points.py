# SPDX-License-Identifier: Apache-2.0
"""The state of a Sweep's points as its status carries it: two bits a point, in base64. Pure."""

from __future__ import annotations

import base64
import binascii


def encode(states: bytes | bytearray) -> str:
    """Return states, one a byte, as text; the first point has the lowest bits of the first byte."""
    padded = bytes(states) + bytes(-len(states) % 4)
    packed = bytes(
        padded[at] | padded[at + 1] << 2 | padded[at + 2] << 4 | padded[at + 3] << 6
        for at in range(0, len(padded), 4)
    )
    return base64.b64encode(packed).decode()


def decode(text: str | None, total: int) -> bytearray:
    """Return the states that a text holds, one a byte; what it does not say is pending."""
    try:
        packed = base64.b64decode(text or "", validate=True)
    except (binascii.Error, ValueError):
        packed = b""
    states = bytearray(value >> shift & 3 for value in packed for shift in (0, 2, 4, 6))
    return states[:total] + bytearray(max(0, total - len(states)))
