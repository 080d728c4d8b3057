# SPDX-License-Identifier: Apache-2.0
"""Manifests of what was run, as YAML that runs it again; pages and commands show the same."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import yaml

from slamhive.model.base import API_VERSION

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from slamhive.model.results import RunRecord

_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""The writer of libyaml where it is there: the same text in a fifth of the time."""

_WIDTH = 100
_SHORT = 90
"""Characters up to which a line is never folded."""

_SCALARS = frozenset({str, int, float, bool, type(None)})
_BELOW = "x"


def manifest(kind: str, name: str, labels: Mapping[str, str], spec: Mapping[str, Any]) -> str:
    """Return the YAML of an object."""
    metadata: dict[str, Any] = {"name": name} | ({"labels": dict(labels)} if labels else {})
    body = {"apiVersion": API_VERSION, "kind": kind, "metadata": metadata, "spec": dict(spec)}
    try:
        return "".join(_lines(body, ""))
    except _NotPlainError:
        return _yaml(body)


class _NotPlainError(Exception):
    """A value needs more than one short line."""


def _lines(body: Mapping[str, Any], indent: str) -> Iterator[str]:
    """Go through the lines of a mapping: the same ones stand in the manifests of many runs."""
    for name, value in body.items():
        if type(value) is dict and value:
            line = indent + _line(name, _BELOW, _BELOW)
            if len(line) > _SHORT or not line[:-1].isprintable():
                raise _NotPlainError
            yield f"{line[: -len(_BELOW) - 2]}\n"
            yield from _lines(value, f"{indent}  ")
        elif type(name) is str and (value == {} or type(value) in _SCALARS):
            line = indent + _line(name, None if value == {} else value, repr(value))
            if len(line) > _SHORT or not line[:-1].isprintable():
                raise _NotPlainError
            yield line
        else:
            raise _NotPlainError


@lru_cache(maxsize=1 << 14, typed=True)
def _line(name: str, value: Any, told: str) -> str:
    """Return the line of a value; ``told`` tells apart what is equal and written otherwise, and {}."""
    return _yaml({name: {} if told == "{}" else value})


def _yaml(body: Mapping[str, Any]) -> str:
    return str(yaml.dump(body, Dumper=_DUMPER, sort_keys=False, allow_unicode=True, width=_WIDTH))


def run_manifest(record: RunRecord, name: str | None = None) -> str:
    """Return the YAML that runs a run again, under another name where one is given."""
    return manifest("MappingRun", name or record.name, {}, spec_again(record))


def spec_again(record: RunRecord) -> dict[str, Any]:
    """Return the fields of a run's spec that say something."""
    return {name: value for name, value in record.spec.items() if value not in (None, {}, [])}


def without_nothing(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields without those that are null or empty, at all depths."""
    found = {
        name: without_nothing(value) if isinstance(value, dict) else value for name, value in fields.items()
    }
    return {name: value for name, value in found.items() if value not in (None, {}, [])}
