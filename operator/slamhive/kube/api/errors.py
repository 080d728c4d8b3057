# SPDX-License-Identifier: Apache-2.0
"""Errors of the Kubernetes API, as exceptions by meaning.

::

    ApiError                  the answer's sentence; status, verb and resource beside it
    ├── NotFound              404
    ├── AlreadyExists         409 on a create: the name is taken
    ├── Conflict              409 on a change: the object is newer than what the change was based on
    ├── Expired               410: a page of a list, or a version, that the server no longer has
    ├── Invalid               400, 422: the server's own sentences about the fields
    ├── Forbidden             403: a right is missing, the quota is used up (waiting helps), a policy's no
    ├── Unauthorized          401
    ├── TooManyRequests       429, with the wait the server asks for
    └── ServerFault           5xx, and connections that broke
    StartError                the operator cannot work here at all

No other module looks at status codes.
"""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    from collections.abc import Mapping

_LONGEST_PLAIN_ANSWER = 300


class ApiError(SlamHiveError):
    """A call that the Kubernetes API did not carry out.

    Args:
        message: the sentence.
        status: HTTP status, 0 where no answer came.
        verb: what was asked, as roles name it.
        resource: of what, as roles name it.
    """

    reason = "ApiError"

    def __init__(self, message: str, *, status: int = 0, verb: str = "", resource: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.verb = verb
        self.resource = resource


class NotFound(ApiError):  # noqa: N818 - named as Kubernetes names it, like all below
    """The object is not there."""

    reason = "NotFound"


class AlreadyExists(ApiError):  # noqa: N818
    """An object of that name is there already."""

    reason = "AlreadyExists"


class Conflict(ApiError):  # noqa: N818
    """The object has changed, or is another one than was meant."""

    reason = "Conflict"
    retryable = True


class Expired(ApiError):  # noqa: N818
    """The server no longer has that version."""

    reason = "Expired"
    retryable = True


class Invalid(ApiError):  # noqa: N818
    """The server refuses the object's content."""

    reason = "Invalid"


class Unauthorized(ApiError):  # noqa: N818
    """The server does not know who asks; a token may be about to be renewed."""

    reason = "Unauthorized"
    retryable = True


class Forbidden(ApiError):  # noqa: N818
    """The operator may not do that, or not now; where a right is missing, that says nothing of the object.

    Attributes:
        is_quota: whether a ResourceQuota is used up, so that waiting helps.
        is_terminating: whether the namespace is being deleted.
    """

    reason = "Forbidden"

    def __init__(self, message: str, *, is_terminating: bool = False, **context: Any) -> None:
        super().__init__(message, **context)
        self.is_quota = means_quota(message)
        self.is_terminating = is_terminating
        self.retryable = self.is_quota or _LACKS_RIGHT.search(message) is not None


_LACKS_RIGHT = re.compile(r'User ".*" cannot \S+ (resource|path) "')
"""The words of every authorizer, which the API server makes; an admission's refusal has words of its own."""


def means_quota(sentence: str) -> bool:
    """Tell whether the API server's sentence on a refused object means that a ResourceQuota is used up.

    Its admission answers 403 Forbidden without causes or details, in Events too: only the words tell it from
    a policy's refusal, for which waiting does not help.
    """
    return "exceeded quota" in sentence


def lacks_class(sentence: str) -> bool:
    """Tell whether the API server's sentence on a refused pod means that its PriorityClass is not there."""
    return "no PriorityClass with name" in sentence


REFUSALS = (Invalid, Forbidden)
"""Answers of the API server where trying again need not help, a used-up quota and missing rights aside."""


class _AskedToWait(ApiError):  # noqa: N818
    """Error after which the call may be made again.

    Attributes:
        retry_after: seconds the server asks to wait, None where it does not say.
    """

    retryable = True

    def __init__(self, message: str, *, retry_after: float | None = None, **context: Any) -> None:
        super().__init__(message, **context)
        self.retry_after = retry_after


class TooManyRequests(_AskedToWait):
    """The server asks to wait."""

    reason = "TooManyRequests"


class ServerFault(_AskedToWait):
    """The server failed, or the connection did; whether the call was carried out is unknown."""

    reason = "ServerFault"


class StartError(SlamHiveError):
    """The operator cannot work here: the sentence says what is missing and how to have it."""

    reason = "StartFailed"


def from_answer(  # noqa: PLR0917 - all of an answer
    status: int, body: bytes, headers: Mapping[str, str], verb: str, resource: str, target: str
) -> ApiError:
    """Return the error that an answer of the server means.

    Args:
        status: HTTP status, 400 or above.
        body: content of the answer, a Status object as a rule.
        headers: headers of the answer.
        verb: what was asked.
        resource: of what.
        target: the address in words, such as ``lab/demo``.
    """
    answer = _status_object(body)
    message = f"cannot {verb} {resource} {target}: {_sentence(answer, body, status)}"
    context: dict[str, Any] = {"status": status, "verb": verb, "resource": resource}
    if status == 409:
        kind = AlreadyExists if answer.get("reason") == "AlreadyExists" else Conflict
        return kind(message, **context)
    if status == 403:
        terminating = any(cause.get("reason") == "NamespaceTerminating" for cause in _causes(answer))
        return Forbidden(message, is_terminating=terminating, **context)
    if status == 429 or status >= 500:
        fault = TooManyRequests if status == 429 else ServerFault
        return fault(message, retry_after=_retry_after(headers, answer), **context)
    kinds: dict[int, type[ApiError]] = {
        400: Invalid,
        401: Unauthorized,
        404: NotFound,
        410: Expired,
        422: Invalid,
    }
    return kinds.get(status, ApiError)(message, **context)


def _status_object(body: bytes) -> dict[str, Any]:
    try:
        answer = json.loads(body)
    except ValueError:
        return {}
    return answer if isinstance(answer, dict) else {}


def _causes(answer: dict[str, Any]) -> list[dict[str, Any]]:
    details = answer.get("details")
    causes = details.get("causes") if isinstance(details, dict) else None
    return [cause for cause in causes or [] if isinstance(cause, dict)]


def _sentence(answer: dict[str, Any], body: bytes, status: int) -> str:
    # The causes say per field what the message runs together.
    sentences = [
        f"{cause['field']}: {cause.get('message', '')}"
        for cause in _causes(answer)
        if cause.get("reason", "").startswith("FieldValue") and cause.get("field", "<nil>") != "<nil>"
    ]
    if sentences:
        return "; ".join(dict.fromkeys(sentences))
    text = answer.get("message") or body[:_LONGEST_PLAIN_ANSWER].decode(errors="replace").strip()
    return str(text) or f"HTTP status {status}"


def _retry_after(headers: Mapping[str, str], answer: dict[str, Any]) -> float | None:
    details = answer.get("details")
    asked = details.get("retryAfterSeconds") if isinstance(details, dict) else None
    try:
        return max(0.0, float(headers.get("Retry-After", asked)))  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None
