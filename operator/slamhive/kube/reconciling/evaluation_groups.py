# SPDX-License-Identifier: Apache-2.0
"""Groups of runs that are measured together: a Sweep's runs, a single run, or what an Evaluation selects.

Sweeps and runs bring their own settings; their groups are queued as Evaluations of the names ``sweep:NAME``
and ``run:NAME``, which no object can have.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from slamhive.analysis.measuring import SETTINGS_KEY, settings_hash
from slamhive.kube.api.kinds import Key, Kind, Label, Object, labels_of, reference
from slamhive.kube.reconciling.catalogue import parse
from slamhive.kube.routing import OWN_EVALUATIONS, is_finished
from slamhive.kube.status import phase_of
from slamhive.model.errors import InputError
from slamhive.model.evaluation import Evaluation, EvaluationSettings
from slamhive.model.results import Phase
from slamhive.model.sweep import Sweep

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.kube.cluster import Cluster
    from slamhive.model.evaluation import Evaluator, RunSelector


SWEEP_PREFIX, RUN_PREFIX = OWN_EVALUATIONS
_MANY = 16
_LONGEST = 5.0


@dataclass
class GroupMemory:
    """Memory of what became of a group's Jobs; an operator that is started anew does without.

    Attributes:
        failures: how many evaluators failed in a row.
        written_at: when its Evaluation's status was last written, s since 1970.
        refused: why its Job is refused; None where it isn't.
        restored: folders that were brought back to the volume.
        trouble: why folders can't be had at present; None where nothing is in the way.
        restore_at: when to ask for folders again, s since 1970.
    """

    failures: int = 0
    written_at: float = 0.0
    refused: str | None = None
    restored: set[str] = field(default_factory=set)
    trouble: str | None = None
    restore_at: float = 0.0

    def forget_folders(self) -> None:
        """Forget what was brought back: nothing needs it any more."""
        self.restored.clear()
        self.trouble, self.restore_at = None, 0.0


@dataclass(frozen=True)
class EvaluationGroup:
    """Runs that are measured alike.

    Attributes:
        key: what it is queued as.
        name: name of the Evaluation, None where the alignment names the result.
        settings: how to measure.
        hash: the hash of that.
        evaluator: the container that measures, None for ours.
        owner: the object whose end ends the Jobs.
        runs: the finished runs that can be measured.
        memory: what became of its Jobs.
        selected: how many runs are selected in all, finished or not.
        ongoing: how many of these have not finished.
    """

    key: Key
    name: str | None
    settings: EvaluationSettings
    hash: str
    evaluator: Evaluator | None
    owner: Object
    runs: list[Object]
    memory: GroupMemory
    selected: int
    ongoing: int = 0

    def wait_seconds(self, delay: float) -> float:
        """Return the time that a batch that isn't full waits for more runs to end, s.

        The more runs are under way, the longer, up to five times the delay: others end soon, and each Job
        costs the cluster what a run's own does.

        Args:
            delay: what a few runs wait, s.
        """
        return delay * min(1 + self.ongoing / _MANY, _LONGEST)

    @property
    def labels(self) -> dict[str, str]:
        """Return the labels by which the end of one of its Jobs leads back to it."""
        for prefix, label in OWN_EVALUATIONS.items():
            if self.key.name.startswith(prefix):
                return {str(label): self.key.name.removeprefix(prefix)}
        return {str(Label.EVALUATION): self.key.name}

    def has_result(self, run: Mapping[str, Any]) -> bool:
        """Tell whether a run has been measured like this."""
        results = run["status"].get("results") or ()
        # Without a name the settings are the identity: another alignment is another result.
        if self.name is None:
            return any(result.get(SETTINGS_KEY) == self.hash for result in results)
        return any(
            result["evaluation"] == self.name and result.get(SETTINGS_KEY) in {self.hash, None}
            for result in results
        )


def key_for(run: Mapping[str, Any]) -> Key | None:
    """Return the key of a finished run's own measurement in the queue; None when none is asked for."""
    status, meta = run["status"], run["metadata"]
    if phase_of(status) is not Phase.SUCCEEDED or not run["spec"].get("evaluate", True):
        return None
    sweep = labels_of(run).get(Label.SWEEP)
    name = f"{SWEEP_PREFIX}{sweep}" if sweep else f"{RUN_PREFIX}{meta['name']}"
    return Key(Kind.EVALUATION, meta["namespace"], name)


def group_of(cluster: Cluster, key: Key, memory: GroupMemory) -> EvaluationGroup | None:
    """Return a group by its key; None when what it belongs to is gone.

    Args:
        cluster: the cluster.
        key: what it is queued as.
        memory: what became of its Jobs.

    Raises:
        InputError: the object is wrong where its CRD could not tell.
    """
    if key.name.startswith(SWEEP_PREFIX):
        return _of_sweep(cluster, key, memory, key.name.removeprefix(SWEEP_PREFIX))
    if key.name.startswith(RUN_PREFIX):
        return _of_run(cluster, key, memory, key.name.removeprefix(RUN_PREFIX))
    return _of_evaluation(cluster, key, memory)


def _of_sweep(cluster: Cluster, key: Key, memory: GroupMemory, name: str) -> EvaluationGroup | None:
    body = cluster.store.get(Key(Kind.SWEEP, key.namespace, name))
    # Jobs of a Sweep that is being deleted would go with it before they have measured.
    if body is None or body["metadata"].get("deletionTimestamp"):
        return None
    runs = cluster.store.select(Kind.MAPPING_RUN, key.namespace, Label.SWEEP, name)
    settings = parse(Sweep, body).spec.evaluation
    owner = reference(Kind.SWEEP, body)
    runs = [run for run in runs if run["spec"].get("evaluate", True)]
    return _group(key, memory, settings, owner, runs)


def _of_run(cluster: Cluster, key: Key, memory: GroupMemory, name: str) -> EvaluationGroup | None:
    run = cluster.store.get(Key(Kind.MAPPING_RUN, key.namespace, name))
    if run is None or run["metadata"].get("deletionTimestamp"):
        return None
    return _group(key, memory, EvaluationSettings(), reference(Kind.MAPPING_RUN, run), [run])


def _of_evaluation(cluster: Cluster, key: Key, memory: GroupMemory) -> EvaluationGroup | None:
    body = cluster.store.get(key)
    if body is None or body["metadata"].get("deletionTimestamp"):
        return None
    spec = parse(Evaluation, body).spec
    if spec.evaluator is not None and not cluster.settings.custom_evaluators:
        raise InputError(
            f"spec.evaluator: {spec.evaluator.image!r} is not run here: the operator's setting "
            "customEvaluators is false, so its own evaluator alone measures"
        )
    settings = EvaluationSettings.model_validate(
        {name: getattr(spec, name) for name in EvaluationSettings.model_fields}
    )
    runs = [run for run in _candidates(cluster, key.namespace, spec.runs) if _selected(spec.runs, run)]
    return _group(
        key, memory, settings, reference(Kind.EVALUATION, body), runs, name=key.name, evaluator=spec.evaluator
    )


def _group(
    key: Key,
    memory: GroupMemory,
    settings: EvaluationSettings,
    owner: Object,
    runs: list[Object],
    *,
    name: str | None = None,
    evaluator: Evaluator | None = None,
) -> EvaluationGroup:
    # `selected` counts all of them, so that an Evaluation waits for runs that are still to end.
    able = [run for run in runs if _can_be_measured(run)]
    ongoing = sum(not is_finished(run) for run in runs)
    return EvaluationGroup(
        key, name, settings, settings_hash(settings), evaluator, owner, able, memory, len(runs), ongoing
    )


def _can_be_measured(run: Object) -> bool:
    status = run["status"]
    alive = not run["metadata"].get("deletionTimestamp")
    return alive and phase_of(status) is Phase.SUCCEEDED and bool(status.get("trajectory"))


def _candidates(cluster: Cluster, namespace: str, selector: RunSelector) -> list[Object]:
    if selector.sweep_ref is not None:
        return cluster.store.select(Kind.MAPPING_RUN, namespace, Label.SWEEP, selector.sweep_ref.name)
    if selector.names:
        found = (cluster.store.get(Key(Kind.MAPPING_RUN, namespace, name)) for name in selector.names)
        return [run for run in found if run is not None]
    return cluster.store.of(Kind.MAPPING_RUN, namespace)


def _selected(selector: RunSelector, run: Object) -> bool:
    labels = labels_of(run)
    return selector.selects(run["metadata"]["name"], labels.get(Label.SWEEP), labels)
