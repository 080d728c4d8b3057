# SPDX-License-Identifier: Apache-2.0
"""Selectors of labels and fields, as queries of the Kubernetes API write them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from fakeapi.refusals import bad_request

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.kube.api.kinds import Object


_SET = re.compile(r"^(?P<key>\S+) (?P<word>in|notin) \((?P<values>[^)]*)\)$")
_EQUAL = re.compile(r"^(?P<key>[^=!\s]+)\s*(?P<word>==?|!=)\s*(?P<value>[^=!\s]*)$")
_EXISTS = re.compile(r"^(?P<word>!?)(?P<key>[^=!\s]+)$")


def selecting(labels: str | None, fields: str | None) -> Callable[[Object], bool]:
    """Return a function that tells whether an object is selected.

    Raises:
        Refusal: a selector can't be read.
    """
    by_label = [_by_label(part) for part in re.split(r",(?![^(]*\))", labels or "") if part]
    by_field = [_by_field(part) for part in (fields or "").split(",") if part]
    return lambda obj: all(holds(obj) for holds in (*by_label, *by_field))


def _by_label(part: str) -> Callable[[Object], bool]:
    part = part.strip()
    if found := _SET.match(part):
        values = {value.strip() for value in found["values"].split(",")}
        key, wanted = found["key"], found["word"] == "in"
        return lambda obj: (_labels(obj).get(key) in values) is wanted
    if found := _EQUAL.match(part):
        key, value, wanted = found["key"], found["value"], found["word"] != "!="
        return lambda obj: (_labels(obj).get(key) == value) is wanted
    if found := _EXISTS.match(part):
        key, wanted = found["key"], not found["word"]
        return lambda obj: (key in _labels(obj)) is wanted
    raise bad_request(f'unable to parse requirement: "{part}"')


def _by_field(part: str) -> Callable[[Object], bool]:
    path, equal, value = part.partition("=")
    if not equal or path.endswith("!"):
        raise bad_request(f'invalid field selector "{part}"')

    def holds(obj: Object) -> bool:
        found: Any = obj
        for name in path.split("."):
            found = found.get(name, "") if isinstance(found, dict) else ""
        return str(found) == value

    return holds


def _labels(obj: Object) -> dict[str, str]:
    return obj["metadata"].get("labels") or {}
