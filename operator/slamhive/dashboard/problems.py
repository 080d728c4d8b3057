# SPDX-License-Identifier: Apache-2.0
"""Errors of the dashboard's API, each with its HTTP status and its JSON body.

::

    Problem               an answer 4xx or 5xx: {"error": sentence, "field": where the mistake was made}
    ├── BadRequest        400 what was asked for can't be understood
    ├── Missing           404 nothing is known by the name
    ├── NotAcceptable     406 the format is not to be had here
    ├── TooLarge          413 more is asked for than is read or computed at a time
    ├── TooCostly         422 computing the answer took more than it may
    ├── SourceUnavailable 503 what the answer comes from does not answer
    │   └── Busy          503 others are being answered
    └── WorkerRefusal     as a worker told it
"""

from __future__ import annotations

from typing import Any

from slamhive.model.errors import InputError, SlamHiveError, SystemFault
from slamhive.runfiles.errors import FileMissingError, FileTooLargeError

RETRY_SECONDS = 5
"""After which what is away or busy may be asked again."""


class Problem(SlamHiveError):  # noqa: N818 - some are no errors
    """An answer that is no result.

    Attributes:
        status: of HTTP.
        field: name of the query parameter or part of the path that is wrong.
        position: where in its text the mistake is, from 0.
        retry_after: s after which it may be asked again; None where that changes nothing.
    """

    status = 500
    retry_after: int | None = None

    def __init__(self, sentence: str, field: str | None = None, position: int | None = None) -> None:
        super().__init__(sentence)
        self.field = field
        self.position = position

    def body(self) -> dict[str, Any]:
        """Return the body of the answer."""
        more = {"position": self.position} if self.position is not None else {}
        return {"error": str(self), "field": self.field, **more}


class BadRequest(Problem):
    """The request can't be understood."""

    status = 400


class Missing(Problem):
    """Nothing is known by the name that was asked for."""

    status = 404


class NotAcceptable(Problem):
    """The format is not to be had here."""

    status = 406


class SourceUnavailable(Problem):
    """Error of a request whose data source does not answer at present: status 503."""

    status = 503
    retry_after = RETRY_SECONDS


class TooLarge(Problem):
    """More is asked for than is read or computed at a time."""

    status = 413


class TooCostly(Problem):
    """Computing the answer took more than it may."""

    status = 422


class Busy(SourceUnavailable):
    """Others are being answered."""

    def __init__(self, sentence: str, retry_after: int = RETRY_SECONDS) -> None:
        super().__init__(sentence)
        self.retry_after = retry_after


class WorkerRefusal(Problem):
    """Error that a worker process sent instead of an answer.

    Args:
        status: of HTTP.
        body: of the answer.
    """

    def __init__(self, status: int, body: dict[str, Any]) -> None:
        super().__init__(str(body["error"]))
        self.status = status
        self._body = body
        self.retry_after = RETRY_SECONDS if status == SourceUnavailable.status else None

    def body(self) -> dict[str, Any]:
        """Return the body of the answer."""
        return self._body


def told(error: BaseException) -> tuple[int, dict[str, Any]] | None:
    """Return status and body of the answer to a mistake; None for one that nobody foresaw."""
    if isinstance(error, Problem):
        return error.status, error.body()
    if isinstance(error, FileMissingError | FileTooLargeError):
        status = Missing.status if isinstance(error, FileMissingError) else TooLarge.status
        return status, {"error": str(error), "field": error.field}
    if isinstance(error, InputError):
        body = {"error": str(error), "field": getattr(error, "field", None)}
        position = getattr(error, "position", None)
        return 400, body if position is None else body | {"position": position}
    if isinstance(error, SystemFault):
        return SourceUnavailable.status, {"error": str(error), "field": None}
    return None
