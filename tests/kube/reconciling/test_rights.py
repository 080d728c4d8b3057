# SPDX-License-Identifier: Apache-2.0
"""Rights of the operator that vanish in the middle of a Sweep and come back: nothing is lost by it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from fakeapi.evaluators import measuring
from fakeapi.refusals import Refusal, forbidden
from testcluster.lab import manifest, run, status_of, sweep, until

from slamhive.archive import Archive
from slamhive.kube.api.client import Api
from slamhive.kube.api.errors import Forbidden
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.loop import FAILURES_TOLD
from slamhive.kube.status import holds

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.lab import Lab

RENDERED = Path(__file__).parents[2] / "helm" / "golden" / "default.yaml"
QUICK = {
    "get pods/log",
    "create jobs.batch",
    "patch mappingruns/status.slamhive.io",
    "watch sweeps.slamhive.io",
}
"""One of each sort; the others are as long."""
RUNS = 6
TIMES = 3 * FAILURES_TOLD
"""Calls that are refused, more than any number of failures that is borne."""


def rules() -> list[Any]:
    """Return the rules of the operator's role in the chart as it is rendered."""
    documents = [one for one in yaml.safe_load_all(RENDERED.read_text()) if one]
    [role] = [
        one
        for one in documents
        if one["kind"] == "Role" and one["metadata"]["labels"]["app.kubernetes.io/component"] == "operator"
    ]
    return list(role["rules"])


def rights() -> list[Any]:
    """Return the operator's rights there, as verb and resource."""
    found = [
        f"{verb} {resource}.{group}".rstrip(".")
        for rule in rules()
        for group in rule["apiGroups"]
        for resource in rule["resources"]
        for verb in rule["verbs"]
    ]
    return [pytest.param(one, marks=() if one in QUICK else pytest.mark.slow) for one in found]


@pytest.mark.parametrize("right", rights())
async def test_a_right_that_vanishes_for_a_while_costs_no_result(
    fake_lab: Lab, right: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("queue.FIRST_BACKOFF_SECONDS", "queue.LAST_BACKOFF_SECONDS", "api.watching._FIRST_PAUSE"):
        monkeypatch.setattr(f"slamhive.kube.{name}", 0.02)
    verb, resource = right.split()
    refused = 0

    def refusing(asked: str, of: str, _body: dict[str, Any]) -> Refusal | None:
        nonlocal refused
        if (asked, of) != (verb, resource) or refused > TIMES:
            return None  # a right that nobody asks for is no loss
        refused += 1
        return forbidden(of, "x", f'User "operator" cannot {verb} resource "{of}" in API group ""')

    fake_lab.cluster.log = measuring()
    fake_lab.cluster.usage = {}
    # Whatever is borne for a time alone is not borne at all here.
    impatient = {"refusalGraceSeconds": 0, "imagePullGraceSeconds": 0, "relistSeconds": 0.2}
    often = {"metrics": {"intervalSeconds": 0.1}, "evaluation": {"delaySeconds": 0.1, "batchSize": 2}}
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        async with fake_lab.operator(archive, **impatient, **often) as op:
            fake_lab.apply(sweep(sizes=RUNS, template={"evaluate": True}, retention={"runs": 0}))
            fake_lab.apply(run(), manifest("Evaluation", "drift", runs={"names": ["one"]}))
            fake_lab.cluster.refuse(refusing)
            fake_lab.cluster.end_watches()
            status = await status_of(op, Kind.SWEEP, "study", lambda found: holds(found, "Complete"))
            await until(lambda: len(op.cluster.store.of(Kind.MAPPING_RUN, "lab")) == 1, "the others to go")
            await status_of(op, Kind.EVALUATION, "drift", lambda found: found.get("evaluated") == 1)
        measured = [bool(record.results) for record in archive.runs(sweep="study")]
    assert (status["succeeded"], status["evaluated"]) == (RUNS, RUNS)
    assert measured == [True] * RUNS


async def test_a_kind_that_may_not_be_listed_keeps_no_other_one_from_being_listed(fake_lab: Lab) -> None:
    asked: list[str] = []

    def refusing(verb: str, of: str, _body: dict[str, Any]) -> Refusal | None:
        asked.extend([of] if verb == "list" else [])
        return forbidden(of, "x", "no such right") if (verb, of) == ("list", "sweeps.slamhive.io") else None

    async with fake_lab.operator() as op:
        fake_lab.cluster.refuse(refusing)
        with pytest.raises(Forbidden, match="no such right"):
            await op.relist()
    assert {kind.resource for kind in Kind} <= set(asked)


async def test_a_watch_that_is_refused_is_told_in_a_sentence(
    fake_lab: Lab, caplog: pytest.LogCaptureFixture
) -> None:
    def refusing(verb: str, of: str, _body: dict[str, Any]) -> Refusal | None:
        return forbidden(of, "x", "no such right") if (verb, of) == ("watch", "pods") else None

    fake_lab.cluster.refuse(refusing)
    async with fake_lab.operator():
        await until(
            lambda: 'cannot watch pods lab: pods "x" is forbidden: no such right' in caplog.text, "it"
        )


@pytest.mark.cluster
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "right", ["create jobs.batch", "patch mappingruns/status.slamhive.io", "delete jobs.batch"]
)
async def test_a_right_that_an_authorizer_takes_away_costs_no_result(
    make_real_lab: Callable[..., Lab], right: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same by roles of a real API server, with its own words."""
    monkeypatch.setattr("slamhive.kube.queue.LAST_BACKOFF_SECONDS", 0.2)
    lab = make_real_lab()
    verb, resource = right.split()
    named, _, group = resource.partition(".")

    def bind(lacking: str | None) -> None:
        verbs = {
            (part, name): [word for word in rule["verbs"] if (word, name, part) != (lacking, named, group)]
            for rule in rules()
            for part in rule["apiGroups"]
            for name in rule["resources"]
        }
        held = [
            {"apiGroups": [part], "resources": [name], "verbs": words}
            for (part, name), words in verbs.items()
            if words
        ]
        head = {"apiVersion": "rbac.authorization.k8s.io/v1", "metadata": {"name": "operator"}}
        account = {"kind": "ServiceAccount", "name": "default", "namespace": lab.namespace}
        role = {"apiGroup": "rbac.authorization.k8s.io", "kind": "Role", "name": "operator"}
        lab.apply(
            head | {"kind": "Role", "rules": held},
            head | {"kind": "RoleBinding", "roleRef": role, "subjects": [account]},
        )

    async def logs(api: Api, namespace: str, pod: str, container: str) -> str:
        return measuring()(await api.get(Key(Kind.POD, namespace, pod)), container)

    monkeypatch.setattr(Api, "logs", logs)
    bind(None)
    kubeconfig = yaml.safe_load(lab.cluster.kubeconfig.read_text())
    token = lab.cluster.kubectl("create", "token", "default", "-n", lab.namespace).strip()
    kubeconfig["users"] = [one | {"user": {"token": token}} for one in kubeconfig["users"]]
    (tmp_path / "kubeconfig").write_text(yaml.safe_dump(kubeconfig))
    held = replace(lab, cluster=replace(lab.cluster, kubeconfig=tmp_path / "kubeconfig"))
    async with held.operator(refusalGraceSeconds=0, evaluation={"delaySeconds": 0.1, "batchSize": 2}) as op:
        refused: list[str] = []
        count = op.cluster.api.count

        def counted(asked: str, of: str, code: str) -> None:
            if count is not None:
                count(asked, of, code)
            # Calls are named after what they are about, rights after what may be done with it.
            if (asked, of.replace(".slamhive.io/status", "/status.slamhive.io"), code) == (
                verb,
                resource,
                "403",
            ):
                refused.append(of)

        op.cluster.api.count = counted
        bind(verb)
        lab.apply(sweep(sizes=RUNS, template={"evaluate": True}))
        await until(lambda: len(refused) > TIMES, "the right to be missed")
        bind(None)
        status = await status_of(op, Kind.SWEEP, "study", lambda found: holds(found, "Complete"))
    assert (status["succeeded"], status["evaluated"]) == (RUNS, RUNS)
