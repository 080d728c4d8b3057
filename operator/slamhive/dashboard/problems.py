# SPDX-License-Identifier: Apache-2.0
"""What goes wrong between a request and its answer.

::

    Problem               an answer 4xx or 5xx: {"error": sentence, "field": where the mistake was made}
    ├── BadRequest        400 what was asked for can't be understood
    ├── Missing           404 nothing is known by the name
    ├── NotAcceptable     406 the format is not to be had here
    └── Unavailable       503 what the answer comes from does not answer
"""

from __future__ import annotations

from typing import Any

from slamhive.model.errors import SlamHiveError


class Problem(SlamHiveError):  # noqa: N818 - some are no errors
    """An answer that is no result.

    Attributes:
        status: of HTTP.
        field: name of the query parameter or part of the path that is wrong.
        position: where in its text the mistake is, from 0.
    """

    status = 500

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


class Unavailable(Problem):
    """What the answer comes from does not answer at present."""

    status = 503
