# SPDX-License-Identifier: Apache-2.0
"""An API server that refuses, forgets to answer and cuts watches: at the end there is the same."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from faultlab.proxy import Trouble, proxied
from faultlab.scenarios import SCENARIOS

from slamhive.kube.api.transport import Transport

if TYPE_CHECKING:
    from pathlib import Path

    from faultlab.arena import Arena, Instance, Outcome

CALLS = {
    "409": Trouble(status=409),
    "409 taken": Trouble(taken=True),
    "410": Trouble(status=410),
    "429": Trouble(status=429),
    "500": Trouble(status=500),
    "500 though done": Trouble(status=500, executed=True),
    "reset": Trouble(reset=True),
    "reset though done": Trouble(reset=True, executed=True),
}
WATCHES: dict[str, tuple[Trouble, dict[str, Any]]] = {
    "cut": (Trouble(cut_after=3), {}),
    "expired": (Trouble(expired_after=2), {}),
    "silent": (Trouble(silent_after=2), {"relistSeconds": 0.5}),
    "late": (Trouble(late_seconds=0.5), {}),
    "pages that expire": (Trouble(one_page=True), {"relistSeconds": 0.1}),
}


async def through_a_proxy(
    arena: Arena, trouble: Trouble, folder: Path, settings: dict[str, Any]
) -> tuple[Outcome, dict[str, int]]:
    kubeconfig = folder / "kubeconfig"

    async def course(instance: Instance) -> Outcome:
        return await instance.finish(**settings)

    async with proxied(arena.admin, trouble, kubeconfig) as proxy:
        return await arena.play(SCENARIOS["study"], course, kubeconfig), proxy.hits


@pytest.mark.parametrize("name", CALLS)
async def test_each_call_fails_before_it_succeeds(
    arena: Arena, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    expected = await arena.undisturbed(SCENARIOS["study"])
    # Nothing is repeated by the client: each answer reaches a reconciler.
    monkeypatch.setitem(Transport.__init__.__kwdefaults__, "attempts", 1)
    found, hits = await through_a_proxy(arena, CALLS[name], tmp_path, {})
    assert found == expected
    assert min(hits[method] for method in ("POST", "PATCH", "DELETE")) >= 2


@pytest.mark.parametrize("status", [403, 422])
async def test_jobs_that_stay_refused(arena: Arena, tmp_path: Path, status: int) -> None:
    kubeconfig = tmp_path / "kubeconfig"

    async def course(instance: Instance) -> list[dict[str, Any]]:
        outcome = await instance.finish(refusalGraceSeconds=0.5)
        assert outcome.created["jobs"] == {}
        return [run["status"] for run in instance.arena.seen.alive("mappingruns", instance.namespace)]

    async with proxied(arena.admin, Trouble(refused_jobs=status), kubeconfig):
        [kept] = await arena.play(SCENARIOS["study"], course, kubeconfig)
    assert (kept["phase"], kept["reason"]) == ("Failed", "SystemFault")
    standing = {item["type"]: item for item in kept["conditions"]}
    for kind, holds in (("Admitted", "False"), ("Complete", "True")):
        assert standing[kind]["status"] == holds
        assert "played: " in standing[kind]["message"]


@pytest.mark.parametrize("name", WATCHES)
async def test_watches_and_lists_that_break(arena: Arena, tmp_path: Path, name: str) -> None:
    expected = await arena.undisturbed(SCENARIOS["study"])
    trouble, settings = WATCHES[name]
    found, hits = await through_a_proxy(arena, trouble, tmp_path, settings)
    assert found == expected
    assert hits
