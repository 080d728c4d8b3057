# SPDX-License-Identifier: Apache-2.0
"""Tests of rendering by its own process: hostile templates end with a sentence that names field and line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.model.errors import SettingsError, SystemFault
from slamhive.templating import RenderedFile, place_files, render
from slamhive.templating.process import CPU_SECONDS

if TYPE_CHECKING:
    from pathlib import Path

USUAL = f"it takes more than {CPU_SECONDS:g} s of processor time"
LITTLE = 0.3
TIME, MEMORY = "it takes more than 0.3 s of processor time", "it takes more than 64 MiB of memory"

DOUBLED = "{% set n = namespace(x=[1]) %}{% for i in range(60) %}{% set n.x = [n.x, n.x] %}{% endfor %}"


def rendered(told: dict[str, Any], *templates: str, cpu_seconds: float = CPU_SECONDS) -> list[RenderedFile]:
    files = [(f"{n}.yaml", text) for n, text in enumerate(templates)]
    return render(files, told, "/slamhive", "/slamhive/files", cpu_seconds)


def test_files_are_rendered_together(told: dict[str, Any]) -> None:
    found = rendered(told, "{{ seed }}\r\n", "é {{ cores }}")
    assert found == [RenderedFile("0.yaml", "7\n"), RenderedFile("1.yaml", "é 2")]


@pytest.mark.parametrize(
    ("template", "line", "words"),
    [
        ("{% for i in range(10**12) %}\n{% for j in range(99999) %}{% endfor %}{% endfor %}", 2, USUAL),
        # Each doubling costs nothing; printing it would take longer than the sun lasts.
        (f"{DOUBLED}\n{{{{ n.x }}}}", 2, TIME),
        ("\n{{ 'a' * 10**10 }}", 2, MEMORY),
        ("\n{{ range(10**9)|list }}", 2, MEMORY),
        (
            "{% set n = namespace(x='a') %}{% for i in range(60) %}\n{% set n.x = n.x ~ n.x %}{% endfor %}",
            2,
            MEMORY,
        ),
        ("\n{{ '%10000000000d' % 1 }}", 2, MEMORY),
        ("{% macro m() %}\n{{ m() }}{% endmacro %}{{ m() }}", 2, "nested too deeply"),
        ("\n{% for i in range(10**6) %}0123456789{% endfor %}", 2, "the file gets larger than 1048576 bytes"),
        ("\n{{ nothing }}", 2, "unknown name 'nothing'"),
    ],
)
def test_a_hostile_template_ends_with_a_sentence(
    told: dict[str, Any], template: str, line: int, words: str
) -> None:
    with pytest.raises(SettingsError) as error:
        rendered(told, "fine: {{ seed }}", template, cpu_seconds=LITTLE if words == TIME else CPU_SECONDS)
    assert str(error.value).startswith(f"algorithm 'vins': files.1.template (1.yaml): line {line}: {words}")


def test_one_operation_without_end_is_ended_by_the_kernel(told: dict[str, Any]) -> None:
    """No line is known then: Python is not asked between the steps of one operation."""
    two = DOUBLED + DOUBLED.replace("n.x", "m.x").replace("set n ", "set m ")
    with pytest.raises(SettingsError) as error:
        rendered(told, "", two + "{{ n.x == m.x }}", cpu_seconds=LITTLE)
    assert str(error.value) == f"algorithm 'vins': files.1.template (1.yaml): {TIME} or 64 MiB of memory"


def test_a_machine_that_can_not_render_is_a_fault(
    told: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.executable", "/nowhere/python")
    with pytest.raises(SystemFault, match="settings files can't be rendered: No such file"):
        rendered(told, "")


def test_placed_files_are_read_only_and_written_anew(tmp_path: Path) -> None:
    for text in ("a\n", "b\r\n"):
        place_files([RenderedFile("config/vins.yaml", text)], tmp_path)
        path = tmp_path / "config" / "vins.yaml"
        assert path.read_bytes() == text.encode()
        assert path.stat().st_mode & 0o222 == 0
