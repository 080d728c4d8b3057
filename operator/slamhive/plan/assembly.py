# SPDX-License-Identifier: Apache-2.0
"""Assembly: from the fields that a point sets to its whole spec, and to the hash of that spec.

The hash is put together from the canonical text of the spec's parts, most of which are shared by many
points; it equals the hash of the spec itself, which takes 50 times as long.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

from slamhive.model.canonical import normalize
from slamhive.model.run import UNHASHED, MappingRunSpec, essential
from slamhive.plan.hashes import canonical_text, scalar_text, sort_key
from slamhive.plan.paths import ALGORITHM, PARAMETERS, REPETITION, SEED, SENSORS, Settings, flatten
from slamhive.plan.resolution import complete, order

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.model.algorithm import Algorithm

_CACHE_SIZE = 20_000


def _crd_defaults() -> Settings:
    body = MappingRunSpec.model_validate(
        {"algorithmRef": {"name": "a"}, "datasetRef": {"name": "d"}}
    ).as_json()
    del body["algorithmRef"], body["datasetRef"]
    return flatten(normalize(body), "spec", [], strict=True)


class Assembler:
    """Makes specs and their hashes.

    Args:
        template: fields that the Sweep's template sets.
        algorithms: Algorithms by name; the defaults of those missing are left out.
    """

    def __init__(self, template: Settings, algorithms: Mapping[str, Algorithm]) -> None:
        self._base = _crd_defaults() | template
        self._algorithms = algorithms
        self._sections: dict[object, str] = {}
        self._parameters: dict[str | None, dict[str, str]] = {}
        self._first_seed = int(self._base[SEED])
        self._first_repetition = int(self._base[REPETITION])

    def value(self, settings: Settings, path: Any) -> Any:
        """Return the value of a single field of the spec, before the Algorithm's defaults."""
        return settings[path] if path in settings else self._base.get(path)

    def mode(self, settings: Settings) -> str | None:
        """Return a point's sensor mode: what it names, or the only one of its Algorithm."""
        named: str | None = self.value(settings, SENSORS)
        algorithm = self._algorithms.get(self.value(settings, ALGORITHM) or "")
        if named is None and algorithm is not None and len(algorithm.spec.modes) == 1:
            return str(algorithm.spec.modes[0].name)
        return named

    def seed(self, settings: Settings, repetition: int) -> int:
        """Return the seed of a repetition."""
        return int(settings.get(SEED, self._first_seed)) + repetition

    def number(self, repetition: int) -> int:
        """Return the number of a repetition as the spec gives it."""
        return self._first_repetition + repetition

    def spec(self, settings: Settings, repetition: int) -> dict[str, Any]:
        """Return a point's spec with all defaults filled in."""
        fields = self._base | settings
        fields[REPETITION] = self.number(repetition)
        fields[SEED] = self.seed(settings, repetition)
        spec = _nest(fields)
        complete(spec, self._algorithms.get(fields.get(ALGORITHM, "")))
        plain: dict[str, Any] = normalize(order(spec))
        return plain

    def spec_hash(self, settings: Settings, repetition: int) -> str:
        """Return the hash of a point's spec."""
        algorithm = self.value(settings, ALGORITHM)
        changed: dict[str, list[tuple[Any, ...]]] = {}
        for path, value in settings.items():
            changed.setdefault(path[0], []).append((path, type(value), value))
        texts = {
            "repetition": str(self.number(repetition)),
            "seed": str(self.seed(settings, repetition)),
            "parameters": self._parameters_text(algorithm, changed.get("parameters", [])),
        }
        for name in ("algorithmRef", "datasetRef", "input", "resources", "sensors"):
            texts[name] = self._section_text(name, algorithm, changed.get(name, []))
        body = ",".join([f'"{name}":{texts[name]}' for name in _HASHED if texts[name]])
        return hashlib.sha256(f"{{{body}}}".encode()).hexdigest()

    def _section_text(self, name: str, algorithm: str | None, changed: list[tuple[Any, ...]]) -> str:
        key = (name, algorithm, *changed)
        text = self._sections.get(key)
        if text is None:
            fields = self._base | {path: value for path, _, value in changed}
            spec = _nest({path: value for path, value in fields.items() if path[0] == name})
            complete(spec, self._algorithms.get(algorithm or ""))
            if name == "input":
                spec[name] = essential(spec[name])
            text = canonical_text(normalize(spec[name])) if name in spec else ""
            if len(self._sections) >= _CACHE_SIZE:
                self._sections.clear()
            self._sections[key] = text
        return text

    def _parameters_text(self, algorithm: str | None, changed: list[tuple[Any, ...]]) -> str:
        base = self._parameters.get(algorithm)
        if base is None:
            spec = _nest({path: value for path, value in self._base.items() if path[0] == "parameters"})
            complete(spec, self._algorithms.get(algorithm or ""))
            values = normalize(spec["parameters"])
            base = {name: _pair(name, values[name]) for name in sorted(values, key=sort_key)}
            self._parameters[algorithm] = base
        if not changed:
            return "{" + ",".join(base.values()) + "}"
        texts = base | {path[1]: _pair(path[1], value) for path, _, value in changed}
        if len(texts) != len(base):
            texts = {name: texts[name] for name in sorted(texts, key=sort_key)}
        return "{" + ",".join(texts.values()) + "}"


_HASHED = sorted(
    field.alias or name
    for name, field in MappingRunSpec.model_fields.items()
    if (field.alias or name) not in UNHASHED
)


def _pair(name: str, value: Any) -> str:
    return f"{scalar_text(name)}:{scalar_text(value)}"


def _nest(fields: Settings) -> dict[str, Any]:
    """Return fields as a spec; null means absent but for parameters."""
    spec: dict[str, Any] = {"parameters": {}, "input": {"remap": {}}}
    for path, value in fields.items():
        if value is None and path[:-1] != PARAMETERS:
            continue
        place = spec
        for key in path[:-1]:
            place = place.setdefault(key, {})
        place[path[-1]] = value
    return spec
