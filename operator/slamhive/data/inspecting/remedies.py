# SPDX-License-Identifier: Apache-2.0
"""Manifests of datasets with the repairs that findings propose, a comment at each."""

from __future__ import annotations

import json
from copy import deepcopy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import ValidationError

from slamhive.data.doctor.findings import BY_NUMBER
from slamhive.model.base import NAME_LIMIT, explain
from slamhive.model.dataset import Dataset

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from slamhive.data.doctor.findings import Finding

    Path_ = tuple[str, ...]

_ENDING = "-repaired"
_TOGETHER: dict[str, Callable[[float, float], float]] = {
    "shift": lambda before, more: round(before + more, 9),
    "drift": lambda before, more: before + more + before * more,
    "forceScale": lambda before, more: before * more,
    "rateScale": lambda before, more: before * more,
}
"""Repairs of a stream that is under one already: found in what that leaves."""


class _Dumper(yaml.SafeDumper):
    """Writer of YAML with numbers in one line, such as matrices and those of messages left out."""


def _list_node(dumper: yaml.SafeDumper, data: list[Any]) -> yaml.Node:
    is_flat = not any(isinstance(item, dict) for item in data)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=is_flat)


_Dumper.add_representer(list, _list_node)


@dataclass
class RepairedManifest:
    """A manifest with the repairs of findings.

    Attributes:
        name: The dataset's new name.
        text: The manifest, with comments.
        repaired: Findings that are repaired in it; none: there is nothing to write.
        notes: What was left out, a sentence each.
    """

    name: str
    text: str = ""
    repaired: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def repaired_manifest(dataset: Dataset, findings: Sequence[Finding]) -> RepairedManifest:
    """Return the manifest of a dataset with the repairs that findings propose.

    Where two want different things of one field, the graver one has it; messages that either leaves out are
    left out together. What a dataset is repaired of already is taken together with what was found in the
    repaired stream.

    Args:
        dataset: The dataset as declared.
        findings: The gravest first.
    """
    fits = len(dataset.name) + len(_ENDING) <= NAME_LIMIT and not dataset.name.endswith(_ENDING)
    made = RepairedManifest(dataset.name + _ENDING if fits else dataset.name)
    declared = dataset.as_json()
    body = deepcopy(declared)
    body["metadata"]["name"] = made.name
    places: dict[Path_, list[Finding]] = {}
    for finding in findings:
        tried = deepcopy(body)
        wanted = dict(_leaves(finding.repair))
        try:
            for place, value in wanted.items():
                _take(tried["spec"], declared["spec"], place, value, places.get(place, []))
            Dataset.model_validate(tried)
        except _LeftOutError as error:
            made.notes.append(f"{finding.code} ({finding.sensor}) isn't repaired: {error}")
        except ValidationError as error:
            made.notes.append(
                f"{finding.code} ({finding.sensor}) isn't repaired: {explain(error.errors()[0])}"
            )
        else:
            if tried["spec"] != body["spec"]:
                for place in wanted:
                    places.setdefault(place, []).append(finding)
                body = tried
                made.repaired.append(finding)
    made.text = _commented(body, places)
    return made


class _LeftOutError(Exception):
    """A repair can't be taken beside others."""


def _take(
    spec: dict[str, Any], declared: Mapping[str, Any], place: Path_, value: Any, others: Sequence[Finding]
) -> None:
    """Put a value into a spec.

    Raises:
        _LeftOutError: Another finding has put another one there, or its numbers are of another stream.
    """
    name = ".".join(place)
    *above, key = place
    if others:
        # Numbers are of one stream, whichever finding has them.
        if key == "drop":
            _put(spec, place, sorted({*_at(spec, place), *value}))
        elif _at(spec, place) != value:
            raise _LeftOutError(
                f"{name} would be {json.dumps(value)}, but {others[0].code} comes first, by which it is "
                f"{json.dumps(_at(spec, place))}"
            )
        return
    if key in BY_NUMBER and any(_at(declared, (*above, one)) for one in BY_NUMBER):
        raise _LeftOutError(
            f"{name} counts messages that the dataset's own {' or '.join(BY_NUMBER)} leaves; check and "
            "repair the dataset without these"
        )
    stated, together = _at(declared, place), _TOGETHER.get(key)
    _put(spec, place, value if together is None or stated is None else together(stated, value))


def _leaves(value: Mapping[str, Any], above: Path_ = ()) -> Iterator[tuple[Path_, Any]]:
    for key, item in value.items():
        if isinstance(item, dict):
            yield from _leaves(item, (*above, key))
        elif item not in (None, []):
            yield (*above, key), item


def _at(value: Any, place: Path_) -> Any:
    for key in place:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _put(value: dict[str, Any], place: Path_, item: Any) -> None:
    for key in place[:-1]:
        value = value.setdefault(key, {})
    value[place[-1]] = item


def _commented(body: Mapping[str, Any], places: Mapping[Path_, Sequence[Finding]]) -> str:
    """Return YAML with codes and sentences of findings above each line that they are behind."""
    lines: list[str] = []
    above: list[tuple[int, str]] = []
    text = yaml.dump(dict(body), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=10**6)
    for line in text.splitlines():
        indent = len(line) - len(line.lstrip())
        key = line.strip().split(":", 1)[0]
        if not line.strip().startswith("- "):
            above = [one for one in above if one[0] < indent] + [(indent, key)]
            findings = places.get(tuple(key for _, key in above)[1:], ()) if above[0][1] == "spec" else ()
            lines += [f"{' ' * indent}# {one.code}: {' '.join(one.message.split())}" for one in findings]
        lines.append(line)
    return "\n".join([*lines, ""])
