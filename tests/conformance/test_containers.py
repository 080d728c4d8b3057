# SPDX-License-Identifier: Apache-2.0
"""Checks of an algorithm in containers of this machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.conformance.checking import CheckRequest, check_algorithm
from slamhive.conformance.workstation import OnWorkstation, bench_for_checks
from slamhive.local.programs.containers import Containers
from slamhive.local.programs.containerwords import HOME_LABEL
from slamhive.local.programs.unavailable import Unavailable

from .conftest import HERE, NAME, Notes, behaving

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home
    from slamhive.local.programs.engines import Engine

IMAGE = "slamhive/kiss-icp:1.3.0"
"""One that has python3 and that the fixture of podman builds."""


def test_an_image_is_checked_as_a_process_is(
    home: Home, workshop_of: Callable[[Home], Workshop], podman: Engine
) -> None:
    truth = (home.path / "algorithms" / "actor" / "truth.txt").read_text()
    text = (HERE / "behaving.py").read_text().replace('"assets" / "truth.txt"', '"files" / "truth.txt"')
    templates = {"settings.txt": "size: 1\n", "truth.txt": truth}
    behaving(
        home,
        set(),
        local=None,
        assets=None,
        image=IMAGE,
        command=["python3", "-ISc", text],
        files=[{"path": path, "template": template} for path, template in templates.items()],
        includesReader=True,
    )
    with bench_for_checks(home, workshop_of(home)) as bench:
        executor = OnWorkstation.contained(bench, NAME, "tiny", pull=False)
        findings = check_algorithm(bench, [executor], CheckRequest(NAME, "tiny", 60.0), Notes())
        label = Containers(bench.home).identity()
    found = {finding.check: finding for finding in findings}
    assert {name: one.found for name, one in found.items() if one.answer not in {"pass", "skipped"}} == {}
    assert {one.executor for one in findings} == {"", "container"}
    assert found["settings"].found.startswith("rendered: settings.txt, truth.txt; whether it was read")
    assert "3 runs are equal to the byte" in found["determinism"].found
    assert "the recording has no topic /points" in found["without lidar"].found
    assert "it ended after" in found["SIGTERM"].found
    assert podman.labelled(f"{HOME_LABEL}={label}") == []


def test_an_image_that_is_not_here_is_said(
    home: Home, workshop_of: Callable[[Home], Workshop], podman: Engine
) -> None:
    assert podman.is_podman
    behaving(home, set(), image="localhost/no-such-image:1")
    with bench_for_checks(home, workshop_of(home)) as bench:
        with pytest.raises(Unavailable, match="needs the image localhost/no-such-image:1, which"):
            OnWorkstation.contained(bench, NAME, "tiny", pull=False)
        behaving(home, set())
    with (
        bench_for_checks(home, workshop_of(home)) as bench,
        pytest.raises(Unavailable, match=r"names no image \(spec.image\)"),
    ):
        OnWorkstation.contained(bench, NAME, "tiny", pull=False)
