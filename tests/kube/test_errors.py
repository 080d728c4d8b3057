# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from typing import Any

import pytest

from slamhive.kube.api import errors
from slamhive.kube.api.errors import ApiError, Forbidden, from_answer


def answer(status: int, headers: dict[str, str] | None = None, **body: Any) -> ApiError:
    content = json.dumps(body).encode()
    return from_answer(status, content, headers or {}, "create", "jobs.batch", "lab/demo")


@pytest.mark.parametrize(
    ("status", "reason", "kind", "retryable"),
    [
        (400, "BadRequest", errors.Invalid, False),
        (401, "Unauthorized", errors.Unauthorized, True),
        (403, "Forbidden", errors.Forbidden, False),
        (404, "NotFound", errors.NotFound, False),
        (409, "AlreadyExists", errors.AlreadyExists, False),
        (409, "Conflict", errors.Conflict, True),
        (410, "Expired", errors.Expired, True),
        (422, "Invalid", errors.Invalid, False),
        (429, "TooManyRequests", errors.TooManyRequests, True),
        (500, "InternalError", errors.ServerFault, True),
        (503, "ServiceUnavailable", errors.ServerFault, True),
        (418, "Teapot", errors.ApiError, False),
    ],
)
def test_each_status_has_its_error(status: int, reason: str, kind: type, retryable: bool) -> None:
    error = answer(status, reason=reason, message="said so")
    assert type(error) is kind
    assert error.retryable is retryable
    assert str(error) == "cannot create jobs.batch lab/demo: said so"
    assert (error.status, error.verb, error.resource) == (status, "create", "jobs.batch")


def test_the_causes_of_a_refusal_are_told_by_field() -> None:
    causes = [
        {"reason": "FieldValueInvalid", "field": "spec.timeout", "message": "expected a duration"},
        {"reason": "FieldValueInvalid", "field": "spec.timeout", "message": "expected a duration"},
        {"reason": "FieldValueRequired", "field": "spec.datasetRef", "message": "Required value"},
        {"reason": "FieldValueInvalid", "field": "<nil>", "message": "some rules were not checked"},
    ]
    error = answer(422, message="long", details={"causes": causes})
    expected = "spec.timeout: expected a duration; spec.datasetRef: Required value"
    assert str(error) == f"cannot create jobs.batch lab/demo: {expected}"


def test_a_used_up_quota_is_waited_for() -> None:
    error = answer(403, message='pods "x" is forbidden: exceeded quota: team, requested: cpu=4')
    assert isinstance(error, Forbidden)
    assert error.is_quota
    assert error.retryable


@pytest.mark.parametrize(
    ("sentence", "retryable"),
    [
        (
            'pods "x" is forbidden: User "a" cannot get resource "pods/log" in API group ""',
            True,
        ),
        ('forbidden: User "a" cannot get path "/apis"', True),
        ('pods "x" is forbidden: violates PodSecurity "restricted:latest": hostPath volumes', False),
        ('admission webhook "v" denied the request: the User cannot have resource "x"', False),
    ],
)
def test_a_right_may_be_given_back_and_a_policy_stays(sentence: str, *, retryable: bool) -> None:
    assert answer(403, message=sentence).retryable is retryable


def test_a_namespace_that_goes_is_known() -> None:
    error = answer(403, message="no", details={"causes": [{"reason": "NamespaceTerminating"}]})
    assert isinstance(error, Forbidden)
    assert error.is_terminating
    assert not error.retryable


@pytest.mark.parametrize(
    ("headers", "details", "wait"),
    [
        ({"Retry-After": "7"}, {}, 7.0),
        ({}, {"retryAfterSeconds": 3}, 3.0),
        ({"Retry-After": "Wed, 21 Oct 2026 07:28:00 GMT"}, {}, None),
        ({}, {}, None),
    ],
)
def test_the_wait_that_the_server_asks_for(
    headers: dict[str, str], details: dict[str, int], wait: float | None
) -> None:
    error = answer(429, headers, message="slow down", details=details)
    assert isinstance(error, errors.TooManyRequests)
    assert error.retry_after == wait


@pytest.mark.parametrize("body", [b"", b"upstream is gone", b"[1]", b"null", b'{"details": 5}', b"\xff"])
def test_answers_of_something_else_than_kubernetes(body: bytes) -> None:
    error = from_answer(502, body, {}, "get", "pods", "lab/x")
    assert str(error).startswith("cannot get pods lab/x: ")
    assert len(str(error)) > len("cannot get pods lab/x: ")
