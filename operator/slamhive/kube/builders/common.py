# SPDX-License-Identifier: Apache-2.0
"""Parts of every Job's pod: names, labels, volumes, and the settings that Pod Security demands.

All builders use them.

Text that users wrote enters manifests only as whole list items, as values of labels after `label_value`, and
as values of variables after `literal`: no shell and no ``$(VARIABLE)`` ever reads it.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import TYPE_CHECKING, Any

from slamhive.kube.api.kinds import MANAGER, Label, Role
from slamhive.model.base import GROUP, queue_of
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.kube.settings import Settings

Manifest = dict[str, Any]

ANNOTATION_LIMIT = 200 * 1024
"""Bytes of a request or configuration in an annotation; the API server takes 256 KiB for all of them."""

_ALL_ANNOTATIONS = 256 * 1024


# The length of a label: the names of Jobs and runs are labels of their pods.
_NAME_LENGTH = 63
_HASH_LENGTH = 10
_UID = re.compile(r"^[0-9A-Za-z][0-9A-Za-z-]{0,63}$")
_LABEL_VALUE = re.compile(r"^([A-Za-z0-9]([-A-Za-z0-9_.]{0,61}[A-Za-z0-9])?)?$")


def label(word: str) -> str:
    """Return the full name of a label or annotation of ours."""
    return f"{GROUP}/{word}"


def label_value(text: str) -> str:
    """Return a text as the value of a label: itself where it fits, else shortened with its hash."""
    return text if _LABEL_VALUE.match(text) else short_name(re.sub(r"[^-A-Za-z0-9_.]", "-", text), text)


def short_name(text: str, identity: str | None = None) -> str:
    """Return a name of at most 63 characters that begins like the text and ends in the identity's hash."""
    hashed = hashlib.sha256((identity or text).encode()).hexdigest()[:_HASH_LENGTH]
    head = text[: _NAME_LENGTH - _HASH_LENGTH - 1].strip("-._")
    return f"{head}-{hashed}" if head else hashed


def joined_name(stem: str, end: str) -> str:
    """Return a stem and its ending joined, as a DNS label of at most 63 characters."""
    name = f"{stem.replace('.', '-')}-{end}"
    if len(name) <= _NAME_LENGTH and "." not in stem:
        return name
    # Two long names that begin alike must not become one when they are cut.
    hashed = hashlib.sha256(f"{stem}/{end}".encode()).hexdigest()[:_HASH_LENGTH]
    head = stem.replace(".", "-")[: _NAME_LENGTH - _HASH_LENGTH - len(end) - 2].strip("-")
    return f"{head}-{hashed}-{end}"


def literal(text: str) -> str:
    """Return a text so that Kubernetes, which expands ``$(NAME)`` in it, ends up with the text itself."""
    return text.replace("$", "$$")


def segment(text: str, what: str) -> str:
    """Return an identity after checking that it is a single segment of a path.

    Raises:
        InputError: it isn't.
    """
    if not _UID.match(text):
        raise InputError(f"{what} {text!r} cannot be part of a path: letters, digits and - are allowed")
    return text


def passed_on(values: Mapping[str, str] | None, settings: Settings) -> dict[str, str]:
    """Return the labels or annotations that an object hands to its Job and pods, such as a queue's.

    No others: some have a pod join a network, a Service or an identity that its user may not give it.
    """
    allowed = settings.passed_labels
    prefixes = tuple(name for name in allowed if name.endswith("/"))
    return {key: value for key, value in (values or {}).items() if key in allowed or key.startswith(prefixes)}


def _queue(labels: Mapping[str, str]) -> str | None:
    try:
        return queue_of(labels)
    except ValueError as error:
        raise InputError(f"metadata.labels: {error}") from None


def annotation(text: str, what: str) -> str:
    """Return a text after checking that it fits into an annotation.

    Raises:
        InputError: it is too large.
    """
    size = len(text.encode())
    if size > ANNOTATION_LIMIT:
        raise InputError(f"{what} has {size} bytes, at most {ANNOTATION_LIMIT} fit into an object")
    return text


def request_text(request: Mapping[str, Any]) -> str:
    """Return a request as compact JSON.

    Raises:
        InputError: it doesn't fit into an annotation.
    """
    text = json.dumps(request, separators=(",", ":"), sort_keys=True, ensure_ascii=False, allow_nan=False)
    return annotation(text, "the request")


def variables(values: Mapping[str, str]) -> list[Manifest]:
    """Return environment variables with exactly these values."""
    return [{"name": name, "value": literal(value)} for name, value in values.items()]


def from_field(name: str, path: str) -> Manifest:
    """Return an environment variable that holds a field of the pod."""
    return {"name": name, "valueFrom": {"fieldRef": {"fieldPath": path}}}


def downward(name: str, annotation_name: str, file: str) -> Manifest:
    """Return a volume with an annotation of the pod as a file."""
    path = f"metadata.annotations['{annotation_name}']"
    item = {"path": file, "fieldRef": {"fieldPath": path}}
    return {"name": name, "downwardAPI": {"defaultMode": 0o444, "items": [item]}}


def claim(name: str, claim_name: str, *, read_only: bool = False) -> Manifest:
    """Return a volume by its claim; of a read-only one the kubelet makes no folder that is missing."""
    source = {"claimName": claim_name} | ({"readOnly": True} if read_only else {})
    return {"name": name, "persistentVolumeClaim": source}


def config_map(name: str, source: str) -> Manifest:
    """Return a volume of what is in a ConfigMap."""
    return {"name": name, "configMap": {"name": source, "defaultMode": 0o444}}


def scratch(name: str, size: str, *, memory: bool = False) -> Manifest:
    """Return an empty folder that goes with the pod."""
    return {"name": name, "emptyDir": {"sizeLimit": size} | ({"medium": "Memory"} if memory else {})}


def mount(name: str, path: str, *, read_only: bool = False, **more: str) -> Manifest:
    """Return the mount of a volume in a container; ``more`` is subPath or subPathExpr."""
    return {"name": name, "mountPath": path} | more | ({"readOnly": True} if read_only else {})


def equal_resources(cpu: str, memory: str, *, logs: str, extra: Mapping[str, str] | None = None) -> Manifest:
    """Return resources whose requests are their limits, so that nothing is lent or taken away.

    Disk for logs and scratch is limited alone: few clusters count what nodes have of it.

    Args:
        cpu: processors.
        memory: memory.
        logs: disk for logs and folders that go with the pod.
        extra: devices.
    """
    shared = {"cpu": cpu, "memory": memory, **(extra or {})}
    return {"requests": shared | {"ephemeral-storage": "0"}, "limits": shared | {"ephemeral-storage": logs}}


def container(
    name: str,
    image: str,
    pull_policy: str,
    *,
    command: Sequence[str],
    env: Iterable[Manifest],
    mounts: Iterable[Manifest],
    resources: Manifest,
) -> Manifest:
    """Return a container that restricted Pod Security accepts, without a writable root.

    An empty command leaves the image's own.
    """
    body: Manifest = {
        "name": name,
        "image": image,
        "imagePullPolicy": str(pull_policy),
        "env": list(env),
        "volumeMounts": list(mounts),
        "resources": resources,
        "terminationMessagePolicy": "FallbackToLogsOnError",
        "securityContext": {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        },
    }
    return body | ({"command": [literal(word) for word in command]} if command else {})


def pod_spec(settings: Settings) -> Manifest:
    """Return the common part of all our pods; all run images or read data that others brought."""
    pods = settings.pods
    body: Manifest = {
        "restartPolicy": "Never",
        # These pods run programs of others: they get no token, and no list of the namespace's services.
        "automountServiceAccountToken": False,
        "enableServiceLinks": False,
        "securityContext": {
            "runAsNonRoot": True,
            "runAsUser": settings.uid,
            "runAsGroup": settings.uid,
            "fsGroup": settings.uid,
            "fsGroupChangePolicy": "OnRootMismatch",
            "seccompProfile": {"type": "RuntimeDefault"},
        },
    }
    secrets = [{"name": item} if isinstance(item, str) else item for item in pods.image_pull_secrets]
    optional = {
        "nodeSelector": dict(pods.node_selector),
        "tolerations": list(pods.tolerations),
        "affinity": dict(pods.affinity),
        "runtimeClassName": pods.runtime_class_name,
        "imagePullSecrets": secrets,
        "priorityClassName": pods.priority_class_name,
        "serviceAccountName": pods.service_account_name,
    }
    return body | {key: value for key, value in optional.items() if value}


_APART, _REQUIRED = "podAntiAffinity", "requiredDuringSchedulingIgnoredDuringExecution"
_FROM_RUNS = {
    "labelSelector": {"matchLabels": {Label.ROLE.value: Role.RUN.value}},
    "namespaceSelector": {},
    "topologyKey": "kubernetes.io/hostname",
}
"""Term that keeps a pod off nodes with runs of any namespace, and runs that come later off its own."""


WHOLE_NODE = "slamhive.io/node"
"""Name of the node itself among what a run asks of it: each has one, for a run that shares it with none."""


def away_from_runs(affinity: Mapping[str, Any]) -> Manifest:
    """Return an affinity with which a pod shares its node with no run."""
    apart = affinity.get(_APART) or {}
    return {**affinity, _APART: {**apart, _REQUIRED: [*(apart.get(_REQUIRED) or ()), _FROM_RUNS]}}


def beside_runs(affinity: Mapping[str, Any]) -> Manifest:
    """Return the affinity of a run's pod without what keeps it away from runs."""
    apart = dict(affinity.get(_APART) or {})
    apart[_REQUIRED] = [term for term in apart.get(_REQUIRED) or () if term != _FROM_RUNS]
    found = {**affinity, _APART: {name: terms for name, terms in apart.items() if terms}}
    return {name: rules for name, rules in found.items() if rules}


def job(
    namespace: str,
    name: str,
    pod: Manifest,
    *,
    labels: Mapping[str, str],
    owners: Sequence[Manifest],
    annotations: Mapping[str, str],
    passed_labels: Mapping[str, str] | None = None,
    passed_annotations: Mapping[str, str] | None = None,
    notes: Mapping[str, str] | None = None,
    ttl_seconds: int | None = None,
) -> Manifest:
    """Return a Job of one pod that is never repeated, but for what takes a pod from outside.

    One whose labels name a queue is made suspended.

    Args:
        namespace: where it goes.
        name: its name.
        pod: spec of the pod.
        labels: labels of the Job and its pod.
        owners: references to its owners.
        annotations: annotations of the pod.
        passed_labels: further labels of both, which never replace ours.
        passed_annotations: the same for annotations.
        notes: annotations of the Job alone.
        ttl_seconds: how long it stays when it has finished; None: as long as its owners.

    Raises:
        InputError: the annotations don't fit into an object, or no queue can have the name that they have.
    """
    ours = {str(Label.MANAGED_BY): MANAGER} | {key: label_value(value) for key, value in labels.items()}
    all_labels = dict(passed_labels or {}) | ours
    metadata: Manifest = {"namespace": namespace, "name": name, "labels": all_labels}
    if passed_annotations or notes:
        metadata["annotations"] = {**(passed_annotations or {}), **(notes or {})}
    if owners:
        metadata["ownerReferences"] = list(owners)
    noted = dict(passed_annotations or {}) | dict(annotations)
    size = sum(len(key.encode()) + len(value.encode()) for key, value in noted.items())
    if size > _ALL_ANNOTATIONS:
        raise InputError(f"the annotations have {size} bytes in all, an object holds {_ALL_ANNOTATIONS}")
    spec: Manifest = {
        # Retries are the engine's, which tells a fault of the machine from a result. The Job replaces a pod
        # on its own only after a disruption, and only when that pod has ended: two must not write at once.
        "backoffLimit": 0,
        "podReplacementPolicy": "Failed",
        "podFailurePolicy": {
            "rules": [
                {"action": "Ignore", "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]}
            ]
        },
        "template": {"metadata": {"labels": dict(all_labels), "annotations": noted}, "spec": pod},
    }
    if _queue(all_labels) is not None:
        # Whoever keeps the queue starts it; nobody here ever does.
        spec["suspend"] = True
    if ttl_seconds is not None:
        spec["ttlSecondsAfterFinished"] = ttl_seconds
    return {"apiVersion": "batch/v1", "kind": "Job", "metadata": metadata, "spec": spec}
