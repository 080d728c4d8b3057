# SPDX-License-Identifier: Apache-2.0
"""Hashes and names: equal on every machine, in every version.

They are kept by golden files under tests/plan/golden; a change here loses the results that users have.
"""

from __future__ import annotations

import base64
import hashlib
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import rfc8785

from slamhive.model.canonical import digest, normalize
from slamhive.model.run import UNHASHED, essential
from slamhive.model.sweep import IMMUTABLE

if TYPE_CHECKING:
    from slamhive.model.algorithm import AlgorithmSpec
    from slamhive.model.sweep import Sweep

NAME_LENGTH = 52
"""Longest name of a run: Jobs and pods append to it, and labels hold 63 characters."""

_HASH_LENGTH = 12
_PROSE = ("description", "homepage", "license")


def spec_hash(spec: dict[str, Any]) -> str:
    """Return the hash of a MappingRun's spec, as 64 hexadecimal digits.

    Args:
        spec: with all defaults filled in, as ``resolve`` returns it.
    """
    body = {key: value for key, value in spec.items() if key not in UNHASHED}
    if "input" in body:
        body["input"] = essential(body["input"])
    return digest(normalize(body))


def algorithm_hash(algorithm: AlgorithmSpec) -> str:
    """Return the hash of what an Algorithm says of its program; prose in it doesn't count."""
    body = _without_defaults(algorithm)
    for word in _PROSE:
        body.pop(word, None)
    for parameter in body.get("parameters", {}).values():
        parameter.pop("description", None)
    return digest(normalize(body))


def content_hash(  # noqa: PLR0917 - all that a result depends on
    spec_hash: str,
    algorithm_hash: str,
    dataset_sha256: str,
    preparation: str,
    environment: str,
    prepared_by: str | None = None,
) -> str:
    """Return the hash of all that a result depends on, by which results are reused.

    Args:
        spec_hash: of the run.
        algorithm_hash: of its Algorithm.
        dataset_sha256: checksum of the recording.
        preparation: version of the preparation.
        environment: digest of the container image or of the virtual environment.
        prepared_by: digest of the program that made the recording's frames; None: none did.
    """
    parts = {
        "algorithm": algorithm_hash,
        "dataset": dataset_sha256,
        "environment": environment,
        "preparation": preparation,
        "spec": spec_hash,
    }
    return digest(parts | ({"preparedBy": prepared_by} if prepared_by else {}))


def local_uid(sweep: Sweep) -> str:
    """Return the identity of a Sweep that no server gave one: of its name and what its runs follow from."""
    body = _without_defaults(sweep.spec)
    # A search that is to try more is the same search.
    body.get("search", {}).pop("trials", None)
    return digest(
        normalize({"name": sweep.name, "spec": {key: body[key] for key in IMMUTABLE if key in body}})
    )


def run_name(sweep: str, uid: str, index: int) -> str:
    """Return the name of a run: a DNS label of at most 52 characters.

    Args:
        sweep: name of the Sweep, which is shortened when needed.
        uid: identity of the Sweep.
        index: of the run's point.
    """
    return f"{prefix(sweep)}-{_short(f'{uid}/{index}')}"


@lru_cache(maxsize=64)
def prefix(sweep: str) -> str:
    """Return the begin of the names of a Sweep's runs."""
    return sweep.replace(".", "-")[: NAME_LENGTH - _HASH_LENGTH - 1].rstrip("-")


def _short(text: str) -> str:
    return base64.b32encode(hashlib.sha256(text.encode()).digest()[:10])[:_HASH_LENGTH].decode().lower()


@lru_cache(maxsize=65_536)
def _scalar(_kind: str, value: Any) -> str:
    return rfc8785.dumps(value).decode()


def scalar_text(value: Any) -> str:
    """Return the canonical JSON of a single value, remembered."""
    # The type is part of the key, since True == 1 and 0.0 == 0.
    return _scalar(type(value).__name__, value)


def canonical_text(value: Any) -> str:
    """Return the canonical JSON (RFC 8785) of a normalised value of mappings and single values."""
    if not isinstance(value, dict):
        return scalar_text(value)
    items = [f"{scalar_text(key)}:{canonical_text(value[key])}" for key in sorted(value, key=sort_key)]
    return "{" + ",".join(items) + "}"


def sort_key(key: str) -> bytes:
    """Return the key that RFC 8785 sorts by: UTF-16 code units."""
    return key.encode("utf-16-be", "surrogatepass")


def _without_defaults(model: Any) -> dict[str, Any]:
    # Defaults are left out, so that a later version's new fields leave hashes as they are.
    body: dict[str, Any] = model.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    return body
