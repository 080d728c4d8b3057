# SPDX-License-Identifier: Apache-2.0
"""Canonical JSON and hashes: the same value has the same hash on every machine.

YAML's numbers are first brought to what kubectl would send (10.0 is 10), then the value is written
as RFC 8785 says, and hashed with SHA-256.
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

import rfc8785

from slamhive.model.errors import InputError

_EXACT = 2**53
_WRITTEN_OUT = 10**21  # from here on JSON writers use exponents


def normalize(value: Any, where: str = "") -> Any:
    """Return plain JSON values in which whole numbers are integers.

    Raises:
        InputError: a number that JSON cannot hold exactly, or a value of another type.
    """
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return value if abs(value) < _EXACT else _large(value, where)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise InputError(f"{where or 'value'}: {value} is not a finite number")
        return int(value) if value.is_integer() and abs(value) < _EXACT else value
    if isinstance(value, dict):
        return {
            str(key): normalize(item, f"{where}.{key}" if where else str(key)) for key, item in value.items()
        }
    if isinstance(value, list | tuple):
        return [normalize(item, f"{where}[{number}]") for number, item in enumerate(value)]
    raise InputError(f"{where or 'value'}: {type(value).__name__} is not a JSON value")


def _large(value: int, where: str) -> float:
    """Return the number that an API server wrote as so many digits, such as 1e16."""
    if abs(value) < _WRITTEN_OUT and rfc8785.dumps(float(value)) == str(value).encode():
        return float(value)
    shown = str(value) if abs(value) < _WRITTEN_OUT else "an integer of more than 21 digits"
    raise InputError(f"{where or 'value'}: {shown} is too large, integers go up to 2^53")


def digest(value: Any) -> str:
    """Return the SHA-256 of a JSON value in canonical form, as 64 hexadecimal digits."""
    return hashlib.sha256(rfc8785.dumps(value)).hexdigest()
