# SPDX-License-Identifier: Apache-2.0
"""Objects of the fake API server, and what reading and changing them means.

Objects are replaced, never changed: a list, a watch or a caller may hold an older one. Each write has a
version of its own and is kept, so that watches begin where a list ended.

What the operator's reconcilers rely on is here, and as it is on a real server: tests/kube/test_api_server.py
asserts it of both. What is not here is refused or left out: apply on the server's side, dry runs, deletion in
the foreground, roles, Pod Security, and the validation of built-in kinds.
"""

from __future__ import annotations

import random
import string
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from fakeapi import admission, schema
from fakeapi.refusals import Refusal, bad_request, conflict, expired, not_found
from fakeapi.resources import JOBS, NAMESPACES, PODS, Resource, at

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.kube.api.kinds import Object

Name = tuple[str, str]
"""Namespace, empty for what is in none, and name."""

ENDED = frozenset({"Succeeded", "Failed"})
_STALE = "the object has been modified; please apply your changes to the latest version and try again"
_SERVERS = (
    *("uid", "namespace", "name", "creationTimestamp", "generation"),
    *("deletionTimestamp", "deletionGracePeriodSeconds"),
)
"""Metadata that only the server changes."""


@dataclass(frozen=True)
class Change:
    """One write.

    Attributes:
        version: its version.
        resource: of what.
        before: the object until then; None where it was created.
        after: the object since; None where it was deleted.
    """

    version: int
    resource: Resource
    before: Object | None
    after: Object | None

    @property
    def last(self) -> Object:
        """Return the object as it is now, or as it was at last."""
        found = self.after or self.before
        assert found is not None
        return found


class Objects:
    """All objects, and all changes since the server began or its history was cut."""

    def __init__(self) -> None:
        self.version = 1000  # a real server has written its own objects before the first of a test
        self.oldest = self.version
        """The version before the first change that is still known."""
        self.changes: list[Change] = []
        self.heard: list[Callable[[Change], None]] = []
        """Called with each change."""
        self._objects: dict[Resource, dict[Name, Object]] = {}

    def of(self, resource: Resource, namespace: str = "") -> list[Object]:
        """Return the objects of a resource in a namespace, or in all, by name."""
        found = self._objects.get(resource, {})
        return [found[name] for name in sorted(found) if namespace in {"", name[0]}]

    def all(self) -> list[tuple[Resource, Object]]:
        """Return all objects."""
        return [(kind, obj) for kind, objects in self._objects.items() for obj in objects.values()]

    def get(self, resource: Resource, namespace: str, name: str) -> Object:
        """Return an object.

        Raises:
            Refusal: it is not there.
        """
        try:
            return self._objects[resource][namespace, name]
        except KeyError:
            raise not_found(resource.name, name) from None

    def since(self, version: int) -> list[Change]:
        """Return the changes after a version.

        Raises:
            Refusal: not all of them are known any more.
        """
        if version < self.oldest:
            raise expired(f"too old resource version: {version} ({self.version})")
        return [change for change in self.changes if change.version > version]

    def forget_history(self) -> None:
        """Forget all changes, as a server does after some minutes: older versions have expired."""
        self.oldest = self.version
        self.changes.clear()

    def create(self, resource: Resource, namespace: str, body: Object) -> Object:
        """Take in a new object and return it.

        Raises:
            Refusal: the name is taken, or something is wrong with the object.
        """
        given = body.get("metadata") or {}
        _insist_on_kind(resource, namespace, body)
        if resource.namespaced:
            self.get(NAMESPACES, "", namespace)
        name = given.get("name") or _generated(given)
        metadata = {key: value for key, value in given.items() if key not in _SERVERS}
        metadata |= {"name": name, "uid": str(uuid.uuid4()), "creationTimestamp": now()}
        if resource.namespaced:
            metadata["namespace"] = namespace
        if resource.has_generation:
            metadata["generation"] = 1
        body = body | {"metadata": metadata}
        if resource.has_status:
            body.pop("status", None)
        if resource.schema is not None:
            body = schema.settled(resource.schema, body)
        body = _COMPLETED.get(resource, lambda obj: obj)(body)
        _insist_on_content(resource, body)
        if (namespace, name) in self._objects.get(resource, {}):
            message = f'{resource.name} "{name}" already exists'
            raise Refusal(409, "AlreadyExists", message, {"name": name})
        admission.insist(resource, body, self.of)
        return self._put(resource, None, body)

    def patch(
        self, resource: Resource, namespace: str, name: str, change: Object, subresource: str = ""
    ) -> Object:
        """Change an object by a JSON merge patch and return it.

        Args:
            resource: of what.
            namespace: where.
            name: the object.
            change: the patch.
            subresource: ``status``, or empty for everything else.

        Raises:
            Refusal: the object is not there, is newer, or would be wrong.
        """
        before = self.get(resource, namespace, name)
        after = merged(before, change)
        metadata = after.get("metadata") or {}
        uid = metadata.get("uid")
        if uid != before["metadata"]["uid"]:
            wrong = ("metadata.uid", "FieldValueInvalid", f'Invalid value: "{uid}": field is immutable')
            raise _invalid(resource, name, [wrong])
        if metadata.get("resourceVersion") != before["metadata"]["resourceVersion"]:
            raise conflict(resource.name, name, _STALE)
        kept = {key: before["metadata"][key] for key in _SERVERS if key in before["metadata"]}
        after["metadata"] = {key: value for key, value in metadata.items() if key not in _SERVERS} | kept
        if subresource == "status":
            rest = {key: value for key, value in before.items() if key != "status"}
            after = rest | ({"status": after["status"]} if "status" in after else {})
        elif resource.has_status:
            after.pop("status", None)
            after |= {"status": before["status"]} if "status" in before else {}
        if resource.schema is not None:
            after = schema.settled(resource.schema, after)
        _insist_on_content(resource, after, before)
        if after == before:
            return before
        if resource.has_generation and _content(after) != _content(before):
            after["metadata"]["generation"] = before["metadata"]["generation"] + 1
        return self._put(resource, before, after)

    def delete(self, resource: Resource, namespace: str, name: str, options: Object | None = None) -> Object:
        """Delete an object, or have it end; returns it as it is or was.

        Args:
            resource: of what.
            namespace: where.
            name: the object.
            options: DeleteOptions.

        Raises:
            Refusal: the object is not there, or not the one that was meant.
        """
        before = self.get(resource, namespace, name)
        options = options or {}
        if options.get("propagationPolicy", "Background") != "Background":
            raise bad_request("the fake API server deletes in the background only")
        wanted = options.get("preconditions") or {}
        for field, word, happened in (
            ("uid", "UID", "deleted and then recreated"),
            ("resourceVersion", "ResourceVersion", "modified"),
        ):
            there = before["metadata"][field]
            if wanted.get(field, there) != there:
                told = f"the {word} in the precondition ({wanted[field]}) does not match the {word} in record"
                why = f"{told} ({there}). The object might have been {happened}"
                raise conflict(resource.described_kind, name, why)
        grace = _grace(resource, before, options)
        if not grace and not before["metadata"].get("finalizers"):
            return self._remove(resource, before)
        if before["metadata"].get("deletionTimestamp"):
            return before
        metadata = before["metadata"] | {"deletionTimestamp": now(), "deletionGracePeriodSeconds": grace}
        if "generation" in metadata:
            metadata["generation"] += 1
        return self._put(resource, before, before | {"metadata": metadata})

    def _put(self, resource: Resource, before: Object | None, after: Object) -> Object:
        self.version += 1
        metadata = after["metadata"] | {"resourceVersion": str(self.version)}
        after = after | {"metadata": metadata}
        ends = metadata.get("deletionTimestamp") and not metadata.get("deletionGracePeriodSeconds")
        if ends and not metadata.get("finalizers"):
            return self._forget(resource, after)
        self._objects.setdefault(resource, {})[metadata.get("namespace", ""), metadata["name"]] = after
        self._tell(Change(self.version, resource, before, after))
        return after

    def _remove(self, resource: Resource, before: Object) -> Object:
        self.version += 1
        metadata = before["metadata"] | {"resourceVersion": str(self.version)}
        return self._forget(resource, before | {"metadata": metadata})

    def _forget(self, resource: Resource, last: Object) -> Object:
        metadata = last["metadata"]
        del self._objects[resource][metadata.get("namespace", ""), metadata["name"]]
        self._tell(Change(self.version, resource, last, None))
        return last

    def _tell(self, change: Change) -> None:
        self.changes.append(change)
        for hear in self.heard:
            hear(change)


def now() -> str:
    """Return the time as the server writes it."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def merged(before: Any, change: Any) -> Any:
    """Return a value changed by a JSON merge patch (RFC 7396)."""
    if not isinstance(change, dict):
        return change
    result = dict(before) if isinstance(before, dict) else {}
    for name, item in change.items():
        if item is None:
            result.pop(name, None)
        else:
            result[name] = merged(result.get(name), item)
    return result


def suffix() -> str:
    """Return five characters that make a name unique."""
    return "".join(random.choices(string.ascii_lowercase + string.digits, k=5))


def _generated(metadata: Object) -> str:
    if not metadata.get("generateName"):
        details = {"causes": [{"reason": "FieldValueRequired", "field": "metadata.name"}]}
        raise Refusal(
            422, "Invalid", "metadata.name: Required value: name or generateName is required", details
        )
    return str(metadata["generateName"]) + suffix()


def _content(obj: Object) -> Object:
    return {key: value for key, value in obj.items() if key not in {"metadata", "status"}}


def _grace(resource: Resource, obj: Object, options: Object) -> int:
    """Return the time that an object has to end, s: only a pod that may be running has any."""
    if resource is not PODS or not (obj.get("spec") or {}).get("nodeName"):
        return 0
    if (obj.get("status") or {}).get("phase") in ENDED:
        return 0
    usual = obj["spec"].get("terminationGracePeriodSeconds", 30)
    return int(options.get("gracePeriodSeconds", usual))


def _insist_on_kind(resource: Resource, namespace: str, body: Object) -> None:
    group, _, version = body.get("apiVersion", "").rpartition("/")
    if at(group, version, resource.plural) is not resource or body.get("kind") != resource.kind:
        raise bad_request(f"{body.get('apiVersion')} {body.get('kind')} is no {resource.kind}")
    if (body.get("metadata") or {}).get("namespace", namespace) != namespace:
        raise bad_request(
            "the namespace of the provided object does not match the namespace sent on the request"
        )


def _insist_on_content(resource: Resource, body: Object, before: Object | None = None) -> None:
    found = [] if resource.schema is None else schema.problems(resource.schema, body, before)
    controllers = [
        owner for owner in body["metadata"].get("ownerReferences") or () if owner.get("controller")
    ]
    if len(controllers) > 1:
        why = "Invalid value: Only one reference can have Controller set to true"
        found.append(("metadata.ownerReferences", "FieldValueInvalid", why))
    if found:
        raise _invalid(resource, body["metadata"]["name"], found)


def _invalid(resource: Resource, name: str, found: list[schema.Problem]) -> Refusal:
    causes = [{"field": field, "reason": word, "message": text} for field, word, text in found]
    sentences = ", ".join(f"{field}: {text}" for field, _, text in found)
    told = sentences if len(found) == 1 else f"[{sentences}]"
    message = f'{resource.described_kind} "{name}" is invalid: {told}'
    return Refusal(422, "Invalid", message, {"name": name, "causes": causes})


def _complete_job(body: Object) -> Object:
    uid, name = body["metadata"]["uid"], body["metadata"]["name"]
    labels = {
        "batch.kubernetes.io/controller-uid": uid,
        "batch.kubernetes.io/job-name": name,
        "controller-uid": uid,
        "job-name": name,
    }
    defaults = {"backoffLimit": 6, "completions": 1, "parallelism": 1, "suspend": False}
    template = body["spec"]["template"]
    metadata = template.get("metadata") or {}
    template = template | {"metadata": metadata | {"labels": (metadata.get("labels") or {}) | labels}}
    selector = {"matchLabels": {"batch.kubernetes.io/controller-uid": uid}}
    return body | {
        "spec": defaults | body["spec"] | {"template": template, "selector": selector},
        "status": {},
    }


def _complete_pod(body: Object) -> Object:
    return body | {"status": {"phase": "Pending"}}


_COMPLETED: dict[Resource, Callable[[Object], Object]] = {JOBS: _complete_job, PODS: _complete_pod}
