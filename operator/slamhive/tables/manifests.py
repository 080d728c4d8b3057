# SPDX-License-Identifier: Apache-2.0
"""Manifests of what was run, as YAML that runs it again; pages and commands show the same."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml

from slamhive.model.base import API_VERSION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.model.results import RunRecord

_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""The writer of libyaml where it is there: the same text in a fifth of the time."""


def manifest(kind: str, name: str, labels: Mapping[str, str], spec: Mapping[str, Any]) -> str:
    """Return the YAML of an object."""
    metadata: dict[str, Any] = {"name": name} | ({"labels": dict(labels)} if labels else {})
    body = {"apiVersion": API_VERSION, "kind": kind, "metadata": metadata, "spec": dict(spec)}
    return str(yaml.dump(body, Dumper=_DUMPER, sort_keys=False, allow_unicode=True, width=100))


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
