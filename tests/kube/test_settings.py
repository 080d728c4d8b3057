# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.kube.settings import Settings, load
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

LEAST = """
namespaces: [lab]
image: slamhive:1
volumes: {results: {claim: results}, data: {claim: data}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "operator.yaml"


def test_the_least_settings_have_defaults(file: Path) -> None:
    file.write_text(LEAST)
    settings = load(file)
    assert settings.uid == 65532
    assert settings.evaluation.batch_size == 200
    assert settings.preparation.timeout == "6h"
    assert settings.metrics.interval_seconds == 15
    assert settings.pods.gpu_resource == "nvidia.com/gpu"
    assert Settings.model_validate(settings.as_json()) == settings


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "namespaces: Field required"),
        (LEAST.replace("[lab]", "[]"), "namespaces: at least 1 is needed, here are 0"),
        (LEAST.replace("[lab]", "[Lab]"), "namespaces.0: String should match pattern"),
        (LEAST + "wrokers: 3", "wrokers: unknown setting"),
        (LEAST + "workers: 0", "workers: must be greater than or equal to 1"),
        (LEAST + "metrics: {port: 99999}", "metrics.port: must be less than or equal to 65535"),
        (LEAST + "preparation: {timeout: soon}", "preparation.timeout: expected a duration such as"),
        (
            LEAST + "preparation: {environment: {https proxy: x}}",
            "preparation.environment.https proxy.[key]: String should match pattern",
        ),
        (LEAST + "variantsLimit: much", "variantsLimit: expected a quantity such as"),
        (
            LEAST + "imagePullPolicy: Sometimes",
            "imagePullPolicy: must be 'Always', 'IfNotPresent' or",
        ),
        ("namespaces: [lab", "line 1: not valid YAML"),
        ("- a", "the file: must be a mapping"),
    ],
)
def test_wrong_settings_are_told_by_field(file: Path, text: str, sentence: str) -> None:
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        load(file)
    assert sentence in str(caught.value)
    assert str(file) in str(caught.value)


def test_a_missing_file(file: Path) -> None:
    with pytest.raises(InputError, match=r"operator\.yaml: the operator's settings cannot be read"):
        load(file)


def test_a_file_that_is_no_text(file: Path) -> None:
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="cannot be read"):
        load(file)
