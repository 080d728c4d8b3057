# SPDX-License-Identifier: Apache-2.0
"""Refusals of an API server, as the Status objects that it answers with."""

from __future__ import annotations

from typing import Any


class Refusal(Exception):  # noqa: N818 - a fake server's answer, not a fault of the fake
    """A call that is answered with a Status.

    Args:
        code: HTTP status.
        reason: one word, such as NotFound.
        message: the sentence.
        details: what it is about, with ``causes`` by field.
    """

    def __init__(self, code: int, reason: str, message: str, details: dict[str, Any] | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.status = {
            "kind": "Status",
            "apiVersion": "v1",
            "metadata": {},
            "status": "Failure",
            "message": message,
            "reason": reason,
            "details": details or {},
            "code": code,
        }


def not_found(resource: str, name: str) -> Refusal:
    """Return the refusal of an object that is not there."""
    return Refusal(404, "NotFound", f'{resource} "{name}" not found', {"name": name})


def conflict(resource: str, name: str, why: str) -> Refusal:
    """Return the refusal of an object that is not the one that was meant."""
    return Refusal(
        409, "Conflict", f'Operation cannot be fulfilled on {resource} "{name}": {why}', {"name": name}
    )


def forbidden(resource: str, name: str, why: str) -> Refusal:
    """Return the refusal of something that is not allowed."""
    return Refusal(403, "Forbidden", f'{resource} "{name}" is forbidden: {why}', {"name": name})


def expired(message: str) -> Refusal:
    """Return the refusal of a version that is too old to be known."""
    return Refusal(410, "Expired", message)


def bad_request(message: str) -> Refusal:
    """Return the refusal of a call that makes no sense."""
    return Refusal(400, "BadRequest", message)
