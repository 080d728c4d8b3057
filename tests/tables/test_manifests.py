# SPDX-License-Identifier: Apache-2.0
"""Manifests of runs are what the YAML library writes, whatever stands in them."""

from __future__ import annotations

from typing import Any

import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from slamhive.model.base import API_VERSION
from slamhive.tables.manifests import manifest

texts = st.text(max_size=12) | st.sampled_from(
    ["yes", "1.0", "~", "x: y", " x", "word " * 30, "a\u2028b", "é"]
)
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | texts
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=4)
)


@given(st.dictionaries(texts, values, max_size=5))
@example({"parameters": {"k": 1}, "input": {}})
@example({"k": 1.0, "j": True, "zero": -0.0, "nothing": 0.0})
def test_a_manifest_is_as_the_library_writes_it(spec: dict[str, Any]) -> None:
    body = {"apiVersion": API_VERSION, "kind": "MappingRun", "metadata": {"name": "n"}, "spec": spec}
    expected = yaml.dump(body, Dumper=yaml.CSafeDumper, sort_keys=False, allow_unicode=True, width=100)
    assert manifest("MappingRun", "n", {}, spec) == expected
