# SPDX-License-Identifier: Apache-2.0
"""An extra that isn't there: the sentence, and the line that installs it where slamhive runs."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from slamhive.model import extras
from slamhive.model.errors import InputError

ROOT = Path(__file__).parents[2]
OWN = ROOT / ".venv"


@pytest.mark.parametrize(
    ("checkout", "prefix", "extra", "line"),
    [
        (Path("/usr"), Path("/usr"), "plot", "pip install 'slamhive[plot]'"),
        (ROOT, OWN, "plot", f"make -C {ROOT} install"),
        (ROOT, OWN, "mlflow", f"make -C {ROOT} install"),
        # What takes half a gigabyte is not in make install.
        (ROOT, OWN, "rerun", f"{OWN}/bin/uv pip install --python {OWN} 'rerun-sdk>=0.23'"),
        (ROOT, Path("/elsewhere"), "plot", f"pip install -e '{ROOT}[plot]'"),
    ],
    ids=["by pip", "pinned", "two pinned", "not pinned", "another environment"],
)
def test_one_line_installs_an_extra_where_slamhive_runs(
    checkout: Path, prefix: Path, extra: str, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extras, "_CHECKOUT", checkout)
    monkeypatch.setattr(sys, "prefix", str(prefix))
    assert extras.how_to_install(extra) == line


def test_what_needs_it_is_named() -> None:
    with pytest.raises(InputError) as raised:
        extras.library("no_such_package.part", "plot", "a figure")
    told = f"a figure needs the package no_such_package, of the extra plot: {extras.how_to_install('plot')}"
    assert str(raised.value) == told
