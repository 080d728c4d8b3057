# SPDX-License-Identifier: Apache-2.0
"""Controllers beside the fake API server: Jobs make pods and end with them, what nobody owns goes.

Each looks at objects anew after every change, as the real ones do, and changes them through the same door.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fakeapi.objects import ENDED, now, suffix
from fakeapi.refusals import Refusal
from fakeapi.resources import EVENTS, JOBS, PODS, Resource

if TYPE_CHECKING:
    from fakeapi.objects import Change, Objects

    from slamhive.kube.api.kinds import Object


_OVER = frozenset({"Complete", "Failed"})


class Jobs:
    """Makes a pod for each Job, takes it away when the Job is suspended, and ends the Job when it has ended.

    Args:
        objects: what there is.

    Attributes:
        refused: whether a pod was refused, so that it has to be asked for again.
    """

    def __init__(self, objects: Objects) -> None:
        self._objects = objects
        self._taken: set[str] = set()
        self.refused = False

    def look(self) -> None:
        """Look at all Jobs."""
        self.refused = False
        for job in self._objects.of(JOBS):
            if not job["metadata"].get("deletionTimestamp") and not _over(job):
                self._bring_on(job)

    def _bring_on(self, job: Object) -> None:
        uid = job["metadata"]["uid"]
        pods = [pod for pod in self._objects.of(PODS, job["metadata"]["namespace"]) if _controls(uid, pod)]
        if job["spec"]["suspend"]:
            self._take(pods)
        ended = [pod for pod in pods if pod["status"]["phase"] in ENDED]
        # What a suspended Job's controller deleted counts neither as failed nor as succeeded.
        ended = [pod for pod in ended if pod["metadata"]["uid"] not in self._taken]
        succeeded = sum(pod["status"]["phase"] == "Succeeded" for pod in ended)
        failed = sum(pod["status"]["phase"] == "Failed" and not _ignored(job, pod) for pod in ended)
        live = [pod for pod in pods if pod["status"]["phase"] not in ENDED]
        if not live and not succeeded and failed <= job["spec"]["backoffLimit"]:
            live = self._make_pod(job)
        active = sum("deletionTimestamp" not in pod["metadata"] for pod in live)
        status: Object = {"active": active or None, "succeeded": succeeded or None, "failed": failed or None}
        if not job["spec"]["suspend"]:
            status["startTime"] = job["status"].get("startTime") or now()
        before = next((one["status"] for one in job["status"].get("conditions") or ()), None)
        if succeeded:
            done = [("SuccessCriteriaMet", "CompletionsReached"), ("Complete", "CompletionsReached")]
            text = "Reached expected number of succeeded pods"
            status |= {"completionTime": now(), "conditions": [_condition(*one, text) for one in done]}
        elif failed > job["spec"]["backoffLimit"]:
            lost = [("FailureTarget", "BackoffLimitExceeded"), ("Failed", "BackoffLimitExceeded")]
            text = "Job has reached the specified backoff limit"
            status["conditions"] = [_condition(*one, text) for one in lost]
        elif job["spec"]["suspend"] and before != "True":
            status["conditions"] = [_condition("Suspended", "JobSuspended", "Job suspended")]
        elif not job["spec"]["suspend"] and before == "True":
            resumed = _condition("Suspended", "JobResumed", "Job resumed") | {"status": "False"}
            status |= {"startTime": now(), "conditions": [resumed]}
        metadata = job["metadata"]
        where = (JOBS, metadata["namespace"], metadata["name"])
        self._objects.patch(*where, {"status": status}, "status")

    def _take(self, pods: list[Object]) -> None:
        for pod in pods:
            metadata = pod["metadata"]
            if pod["status"]["phase"] not in ENDED and "deletionTimestamp" not in metadata:
                self._taken.add(metadata["uid"])
                self._objects.delete(PODS, metadata["namespace"], metadata["name"])

    def _make_pod(self, job: Object) -> list[Object]:
        if job["spec"]["suspend"]:
            return []
        template, metadata = job["spec"]["template"], job["metadata"]
        owner = {"apiVersion": "batch/v1", "kind": "Job", "name": metadata["name"], "uid": metadata["uid"]}
        owner |= {"controller": True, "blockOwnerDeletion": True}
        name = f"{metadata['name']}-{suffix()}"
        described = {"generateName": f"{metadata['name']}-", "name": name, "ownerReferences": [owner]}
        body = {"apiVersion": "v1", "kind": "Pod", "metadata": template["metadata"] | described}
        try:
            made = self._objects.create(PODS, metadata["namespace"], body | {"spec": template["spec"]})
        except Refusal as refusal:
            self.refused = True
            self._tell(job, f"Error creating: {refusal}")
            return []
        return [made]

    def _tell(self, job: Object, message: str) -> None:
        metadata = job["metadata"]
        about = {name: metadata[name] for name in ("namespace", "name", "uid")}
        body = {
            "apiVersion": "v1",
            "kind": "Event",
            "metadata": {"name": f"{metadata['name']}.{suffix()}"},
            "involvedObject": {"apiVersion": "batch/v1", "kind": "Job"} | about,
            "type": "Warning",
            "reason": "FailedCreate",
            "message": message,
            "source": {"component": "job-controller"},
            "firstTimestamp": now(),
            "lastTimestamp": now(),
            "count": 1,
        }
        self._objects.create(EVENTS, metadata["namespace"], body)


class Garbage:
    """Deletes what has owners of which none is there any more.

    Args:
        objects: what there is.
    """

    def __init__(self, objects: Objects) -> None:
        self._objects = objects

    def look(self, changes: list[Change]) -> None:
        """Look at what has owners, if an owner may have gone or been missing from the beginning."""
        if not any(change.after is None or change.before is None for change in changes):
            return
        there = {obj["metadata"]["uid"] for _, obj in self._objects.all()}
        for resource, obj in self._objects.all():
            owners = obj["metadata"].get("ownerReferences") or []
            left = [owner for owner in owners if owner["uid"] in there]
            if len(left) < len(owners) and not obj["metadata"].get("deletionTimestamp"):
                self._let_go(resource, obj, left)

    def _let_go(self, resource: Resource, obj: Object, left: list[Object]) -> None:
        metadata = obj["metadata"]
        where = (resource, metadata.get("namespace", ""), metadata["name"])
        if left:
            self._objects.patch(*where, {"metadata": {"ownerReferences": left}})
        else:
            self._objects.delete(*where, {"preconditions": {"uid": metadata["uid"]}})


def _over(job: Object) -> bool:
    return any(
        item["type"] in _OVER and item["status"] == "True" for item in job["status"].get("conditions") or ()
    )


def _controls(uid: str, pod: Object) -> bool:
    return any(
        owner["uid"] == uid and owner.get("controller")
        for owner in pod["metadata"].get("ownerReferences") or ()
    )


def _ignored(job: Object, pod: Object) -> bool:
    """Tell whether the Job's policy leaves a failed pod out of its count."""
    found = {(item["type"], item["status"]) for item in pod["status"].get("conditions") or ()}
    return any(
        rule["action"] == "Ignore" and (condition["type"], condition.get("status", "True")) in found
        for rule in (job["spec"].get("podFailurePolicy") or {}).get("rules") or ()
        for condition in rule.get("onPodConditions") or ()
    )


def _condition(kind: str, reason: str, message: str) -> Object:
    return {
        "type": kind,
        "status": "True",
        "reason": reason,
        "message": message,
        "lastProbeTime": now(),
        "lastTransitionTime": now(),
    }
