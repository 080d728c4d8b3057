# SPDX-License-Identifier: Apache-2.0
"""Base of all models: strictness, metadata, durations and quantities."""

from __future__ import annotations

import re
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
)
from pydantic.alias_generators import to_camel

from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic_core import ErrorDetails

GROUP = "slamhive.io"
VERSION = "v1alpha1"
API_VERSION = f"{GROUP}/{VERSION}"

_MEANINGS: dict[str, str] = {}


def worded(pattern: str, words: str) -> str:
    """Return a pattern of a field, of which mistakes are told in these words."""
    _MEANINGS[pattern] = words
    return pattern


_DURATION = worded(r"^([0-9]{1,5}(h|m|s|ms)){1,4}$", "expected a duration such as 90s, 1h30m or 250ms")
QUANTITY_PATTERN = worded(
    r"^[0-9]+(\.[0-9]+)?(m|k|M|G|T|Ki|Mi|Gi|Ti)?$", "expected a quantity such as 2, 500m or 4Gi"
)
_NAME = worded(r"^[a-z0-9]([-a-z0-9.]*[a-z0-9])?$", "expected a name of lower-case letters, digits, - and .")
QUEUE_NAME = "kueue.x-k8s.io/queue-name"
"""Label of objects whose Jobs Kueue admits: the name of a LocalQueue."""
PRIORITY_CLASS = "kueue.x-k8s.io/priority-class"
"""Label by which Kueue knows what comes first: the name of a WorkloadPriorityClass; without it, by the
PriorityClass of the pods."""
_PART = r"[a-z0-9]+([._-]+[a-z0-9]+)*"
# As registries have it: what an engine would take for an option or a file ("--all", "dir:/x") is no name.
_IMAGE = worded(
    rf"^([A-Za-z0-9][A-Za-z0-9.-]*(:[0-9]+)?/)?{_PART}(/{_PART})*"
    r"(:[A-Za-z0-9_][A-Za-z0-9_.-]{0,127})?(@[a-z0-9]+:[0-9a-f]{32,128})?$",
    "expected the name of an image, without blanks, such as registry.example.org/lab/slam:1.2",
)
_SEGMENT = r"([^/.]|\.[^/.]|\.\.[^/])[^/]*"
RELATIVE_PATH = worded(
    rf"^{_SEGMENT}(/{_SEGMENT})*$", "expected a path below its folder: not absolute, no . or .. in it"
)
CATALOGUE_TITLE = worded(
    r"^[^/\s]+/[^/\s]+$", "expected FAMILY/SEQUENCE of the catalogue, such as euroc/MH_01_easy"
)
HTTPS = worded(r"^https://", "expected an address that begins with https://")
_SHA256 = worded(r"^[0-9a-f]{64}$", "expected a SHA-256 checksum: 64 digits and letters from a to f")
_UNIT_SECONDS = {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 0.001}
_UNIT_SIZE = {
    "": 1.0,
    "n": 1e-9,
    "u": 1e-6,
    "m": 0.001,
    "k": 1e3,
    "M": 1e6,
    "G": 1e9,
    "T": 1e12,
    "Ki": 2.0**10,
    "Mi": 2.0**20,
    "Gi": 2.0**30,
    "Ti": 2.0**40,
}

Duration = Annotated[
    str,
    StringConstraints(pattern=_DURATION),
    Field(description="A duration such as 90s, 1h30m or 250ms (GEP-2257)."),
]


def _integer_as_text(value: object) -> object:
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


Quantity = Annotated[
    str,
    StringConstraints(pattern=QUANTITY_PATTERN),
    BeforeValidator(_integer_as_text),
    Field(description="A quantity as Kubernetes writes it, such as 2, 500m or 4Gi."),
]
Name = Annotated[str, StringConstraints(pattern=_NAME, min_length=1, max_length=253)]
NAME_LIMIT = 63
"""Longest name of an object of ours: it must fit into a label."""
RelativePath = Annotated[
    str,
    StringConstraints(pattern=RELATIVE_PATH, max_length=1024),
    Field(description="A path that stays below its folder: not absolute, no . or .. in it."),
]
SettingsPath = Annotated[
    str,
    StringConstraints(
        pattern=worded(
            r"^[A-Za-z0-9_-][A-Za-z0-9._-]*(/[A-Za-z0-9_-][A-Za-z0-9._-]*)*$",
            "expected a path below its folder: letters, digits, . _ - and /, no part that begins with a dot",
        ),
        max_length=255,
    ),
    Field(description="A path below its folder: letters, digits, . _ - and /, no part beginning with a dot."),
]
Image = Annotated[str, StringConstraints(pattern=_IMAGE)]
Sha256 = Annotated[str, StringConstraints(pattern=_SHA256)]
Scalar = bool | int | float | str | None


class Model(BaseModel):
    """A frozen record of the language: unknown fields are refused, names are camelCase outside."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        alias_generator=to_camel,
        populate_by_name=True,
        allow_inf_nan=False,
        defer_build=True,  # a command that never meets a kind need not pay for its validator
    )

    def as_json(self) -> dict[str, Any]:
        """Return the record as plain JSON values under its outside names, absent fields left out."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True)

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some fields changed (the changes are trusted, not validated)."""
        return self.model_copy(update=changes)


def optional(description: str, **settings: Any) -> Any:
    """Return a field that may be absent, with its description for `kubectl explain`; settings as Field's."""
    return Field(default=None, description=description, **settings)


def plural(count: int, noun: str) -> str:
    """Return a count with its noun.

    >>> plural(1, "run"), plural(3, "run")
    ('1 run', '3 runs')
    """
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


class Choice(StrEnum):
    """An enumeration of words; members print as the word itself."""


def _with_a_queue(labels: dict[str, str]) -> dict[str, str]:
    queue_of(labels)
    return labels


Labels = Annotated[dict[str, str], AfterValidator(_with_a_queue)]
"""Labels whose queue, if they name one, has a name that a queue can have."""


def queue_of(labels: Mapping[str, str]) -> str | None:
    """Return the queue that labels name; None where they name none.

    Raises:
        ValueError: no queue can have this name, of which Kueue itself would say nothing.
    """
    name = labels.get(QUEUE_NAME)
    if name and (len(name) > NAME_LIMIT or not re.match(_NAME, name)):
        raise ValueError(
            f"{QUEUE_NAME}: {_MEANINGS[_NAME]}, at most {NAME_LIMIT} characters, "
            f"found {name!r}{proposal(name)}"
        )
    return name or None


class ObjectMeta(Model):
    """The part of Kubernetes' object metadata that means something here."""

    model_config = ConfigDict(extra="ignore")

    name: Name = Field(max_length=NAME_LIMIT)
    namespace: str | None = None
    uid: str | None = None
    labels: Labels = Field(default_factory=dict)
    annotations: dict[str, str] = Field(default_factory=dict)


def plain_name(text: str) -> str:
    """Return a name of an object that is made of a file's or a sequence's.

    >>> plain_name("Second floor (1)"), plain_name("MH_01_easy")
    ('second-floor-1', 'mh-01-easy')
    """
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-.")[:NAME_LIMIT].strip("-.")


def proposal(name: object) -> str:
    """Return the end of a sentence on a text that is no name: one like it that is; empty without any."""
    plain = plain_name(name) if isinstance(name, str) else ""
    return f"; try {plain}" if plain else ""


def require_name(name: str, field: str) -> None:
    """Refuse a text that is no name of an object, and propose one that is.

    Raises:
        InputError: it is none.
    """
    if len(name) > NAME_LIMIT:
        raise InputError(f"{len(name)} characters are too many, at most {NAME_LIMIT} are allowed", field)
    try:
        ObjectMeta.model_validate({"name": name})
    except ValidationError as error:
        raise InputError(f"{explain(error.errors()[0])}, found {name!r}{proposal(name)}", field) from None


class Reference(Model):
    """The name of another object in the same namespace."""

    name: Name = Field(description="Name of the object.")


class Resource(Model):
    """An object of one of our kinds."""

    api_version: str = API_VERSION
    kind: str
    metadata: ObjectMeta

    @property
    def name(self) -> str:
        """Return the object's name."""
        return self.metadata.name


_TYPES = {
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "dict_type": "must be a mapping",
    "model_type": "must be a mapping",
    "string_type": "must be a text",
    "int_type": "must be a whole number",
    "float_type": "must be a number",
    "bool_type": "must be true or false",
}
"""Demands on a value by pydantic's kinds of error, in the words of a manifest."""


def meaning(pattern: str) -> str | None:
    """Return in words what a pattern asks, None where nobody has written it down."""
    return _MEANINGS.get(pattern)


def explain(error: ErrorDetails) -> str:
    """Return the sentence on a mistake found by pydantic, patterns put in words."""
    context = error.get("ctx", {})
    found = error.get("input")
    if error["type"] == "enum" and isinstance(found, dict | list):
        return f"takes one word{_word_among(found, str(context.get('expected')))}"
    if error["type"] == "too_long":
        return f"at most {context['max_length']} are allowed, here are {context['actual_length']}"
    if error["type"] == "too_short":
        least = context["min_length"]
        return f"at least {least} {'is' if least == 1 else 'are'} needed, here are {context['actual_length']}"
    pattern = context.get("pattern")
    said = error["msg"].removeprefix("Value error, ").replace("Input should be", "must be", 1)
    return _TYPES.get(error["type"]) or meaning(str(pattern)) or said


def _word_among(found: dict[str, Any] | list[Any], expected: str) -> str:
    """Return the word that was meant by a mapping or a list with it, or all that are known.

    Args:
        found: as in ``{mode: stereo}``.
        expected: the known words, each in quotes.
    """
    known = re.findall(r"'([^']*)'", expected)
    written = found.values() if isinstance(found, dict) else found
    meant = [word for word in known if word in written]
    return f", such as {meant[0]!r}" if meant else f": {expected}"


def seconds(duration: str) -> float:
    """Return the length of a duration in seconds.

    >>> seconds("1h30m")
    5400.0
    """
    parts = re.findall(r"([0-9]+)(h|ms|m|s)", duration)
    return sum(int(number) * _UNIT_SECONDS[unit] for number, unit in parts)


def quantity(text: str) -> float:
    """Return a quantity of Kubernetes as a number; the metrics API counts in n and u, manifests do not.

    >>> quantity("4Gi"), quantity("500m"), quantity("12345678n")
    (4294967296.0, 0.5, 0.012345678)

    Raises:
        ValueError: it is none.
    """
    match = re.fullmatch(r"([0-9.]+)([a-zA-Z]*)", text)
    if match is None or match.group(2) not in _UNIT_SIZE:
        raise ValueError(f"{text!r} is not a quantity such as 2, 500m or 4Gi")
    return float(match.group(1)) * _UNIT_SIZE[match.group(2)]
