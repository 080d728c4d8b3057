# SPDX-License-Identifier: Apache-2.0
"""Remarks of the readers of recordings on their files; apart from them, as they load slowly."""

from __future__ import annotations

from typing import NamedTuple


class NotDamagedError(Exception):
    """A recording that can't be read and isn't damaged; its text is a whole sentence with what helps."""


class Notice(NamedTuple):
    """A remark on a recording's files: its code, a sentence, and the number of messages or channels."""

    code: str
    text: str
    number: int = 1
