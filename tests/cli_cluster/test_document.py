# SPDX-License-Identifier: Apache-2.0
"""Test of docs/cluster.md: its commands, typed word for word beside an operator.

Evaluations are played as pods are.
"""

from __future__ import annotations

import asyncio
import re
import shlex
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.analysis.measuring import SETTINGS_KEY, settings_hash
from slamhive.kube.api.errors import Conflict
from slamhive.kube.api.kinds import Kind, key_of
from slamhive.model.evaluation import EvaluationSettings

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.lab import Lab

    from conftest import Desk
    from slamhive.kube.operator import Operator

TEXT = (Path(__file__).parents[2] / "docs" / "cluster.md").read_text()
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"^# (\S+\.yaml)\n")


async def measure(op: Operator) -> None:
    """Give each run that has succeeded a result, as an evaluator's pod would."""
    result = {"evaluation": "default", "outcome": "Tracked", "coverage": 1.0, "ate": {"rmse": 0.5}}
    result[SETTINGS_KEY] = settings_hash(EvaluationSettings())
    while True:
        await asyncio.sleep(0.05)
        for run in op.cluster.store.of(Kind.MAPPING_RUN, op.cluster.settings.namespaces[0]):
            status = run["status"]
            if status.get("phase") != "Succeeded" or status.get("results"):
                continue
            body = {
                "metadata": {"resourceVersion": run["metadata"]["resourceVersion"]},
                "status": {"results": [result]},
            }
            with suppress(Conflict):
                await op.cluster.patch(key_of(Kind.MAPPING_RUN, run), body, subresource="status")


async def test_commands_do_what_the_document_says(make_lab: Callable[..., Lab], desk: Desk) -> None:
    lab = make_lab(catalog=False)
    for language, block in FENCE.findall(TEXT):
        if language == "yaml" and (file := FILE.match(block)):
            (desk.folder / file.group(1)).write_text(block)
    said = {}
    async with lab.operator() as op:
        measuring = asyncio.create_task(measure(op))
        for language, block in FENCE.findall(TEXT):
            for line in block.splitlines() if language == "bash" else ():
                program, *words = shlex.split(line)
                assert program == "slamhive"
                # No played pod can send files: tests/e2e fetches them.
                words = [word for word in words if word != "--files"]
                said[line] = await desk.types(*words)
                assert said[line].code == 0, f"{line}\n{said[line].text}"
        measuring.cancel()
    assert "sizes: 4 runs: 4 succeeded, 0 failed" in said["slamhive run sizes.yaml --on cluster"].out
    assert "0.5" in said["slamhive results table --sweep sizes"].out
    assert "Sweep sizes: unchanged, 4 runs" in said["slamhive submit sizes.yaml"].out
    assert "Tracked, ATE 0.5 m" in said["slamhive status try"].text
    assert not lab.cluster.get("sweeps", "-n", lab.namespace)["items"]
