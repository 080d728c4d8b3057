# SPDX-License-Identifier: Apache-2.0
"""Store of the cluster's objects, narrowed to what is needed and found by name, label and owner.

Watches, the operator's own writes and full lists all write here, in any order: an object never goes back to
an older version, and one that was deleted does not return by a late message. What the store hands out is
shared: never change it.
"""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from typing import TYPE_CHECKING, Any

from slamhive.kube.api.kinds import Key, Kind, Label, Object, Role, key_of, labels_of, owner_uids

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


INDEXED_LABELS = (Label.RUN, Label.SWEEP, Label.VARIANT, Label.EVALUATION)
_LATEST_DELETIONS = 20_000
_METADATA = (
    "name",
    "namespace",
    "uid",
    "resourceVersion",
    "generation",
    "creationTimestamp",
    "deletionTimestamp",
    "deletionGracePeriodSeconds",
    "labels",
    "annotations",
    "ownerReferences",
    "finalizers",
)
_APPLIED = "kubectl.kubernetes.io/last-applied-configuration"
_POD_STATUS = ("phase", "reason", "message", "conditions", "startTime")
_CONTAINERS = ("initContainerStatuses", "containerStatuses")
_CONTAINER_STATUS = ("name", "state", "lastState", "ready", "started", "restartCount", "image", "imageID")

_Index = tuple[Kind, str, str, str]


class Store:
    """Objects by kind, namespace and name."""

    def __init__(self) -> None:
        self._objects: dict[tuple[Kind, str], dict[str, Object]] = defaultdict(dict)
        self._labelled: dict[_Index, dict[str, None]] = {}
        self._owned: dict[str, dict[Key, None]] = {}
        self._deleted: OrderedDict[str, None] = OrderedDict()
        self._untold: dict[str, Object] = {}

    def __len__(self) -> int:
        """Return the number of objects."""
        return sum(len(objects) for objects in self._objects.values())

    def put(self, kind: Kind, obj: Object, *, narrowed: bool = False) -> bool:
        """Take an object in; returns whether it was news.

        An older version than the one here, the same version, and objects known to be deleted are not.

        Args:
            kind: its kind.
            obj: the object.
            narrowed: whether it has gone through ``narrow`` already.
        """
        key = key_of(kind, obj)
        if obj["metadata"].get("uid") in self._deleted:
            return False
        present = self.get(key)
        is_older = present is not None and version_of(obj) <= version_of(present)
        if present is not None and obj["metadata"].get("uid") != present["metadata"].get("uid"):
            # A name is given again only after its former object is gone, whether or not we heard of that.
            former = obj if is_older else present
            self._remember_deletion(former["metadata"].get("uid", ""))
        if is_older:
            return False
        kept = obj if narrowed else narrow(kind, obj)
        if obj["metadata"].get("uid") in self._untold:
            kept = kept | {"status": self._untold[obj["metadata"]["uid"]]}
        if present is not None:
            self._unlink(key, present)
        self._objects[kind, key.namespace][key.name] = kept
        self._link(key, kept)
        return True

    def keep_untold(self, kind: Kind, seen: Object, status: Object) -> Object | None:
        """Have an object a status that the API is not told of, in whatever version it comes from there.

        Args:
            kind: its kind.
            seen: the object as it was read.
            status: its whole status.

        Returns:
            The object with it; None where it is gone or has changed since.
        """
        key = key_of(kind, seen)
        if self.get(key) is not seen:
            return None
        self._untold[seen["metadata"]["uid"]] = status
        kept = seen | {"status": status}
        self._objects[kind, key.namespace][key.name] = kept
        return kept

    def is_untold(self, obj: Object) -> bool:
        """Tell whether an object's status is known here alone."""
        return obj["metadata"].get("uid") in self._untold

    def remove(self, kind: Kind, namespace: str, name: str, uid: str | None = None) -> bool:
        """Take out an object that was deleted; returns whether it was here.

        Args:
            kind: its kind.
            namespace: its namespace.
            name: its name.
            uid: its uid: a later object of the same name stays.
        """
        if uid is not None:
            self._remember_deletion(uid)
        key = Key(kind, namespace, name)
        present = self.get(key)
        if present is None or (uid is not None and present["metadata"].get("uid") != uid):
            return False
        self._remember_deletion(present["metadata"].get("uid", ""))
        self._unlink(key, present)
        del self._objects[kind, namespace][name]
        return True

    def get(self, key: Key) -> Object | None:
        """Return an object, None when it is not there."""
        return self._objects[key.kind, key.namespace].get(key.name)

    def of(self, kind: Kind, namespace: str) -> list[Object]:
        """Return all objects of a kind in a namespace, in the order they came."""
        return list(self._objects[kind, namespace].values())

    def select(self, kind: Kind, namespace: str, label: str, value: str) -> list[Object]:
        """Return the objects with a label, at once for those of ``INDEXED_LABELS``."""
        objects = self._objects[kind, namespace]
        if label in INDEXED_LABELS:
            return [objects[name] for name in self._labelled.get((kind, namespace, str(label), value), ())]
        return [obj for obj in objects.values() if labels_of(obj).get(label) == value]

    def referring(self, namespace: str, to: Kind, name: str) -> list[Object]:
        """Return the MappingRuns that name an Algorithm or a Dataset in their spec."""
        objects = self._objects[Kind.MAPPING_RUN, namespace]
        names = self._labelled.get((Kind.MAPPING_RUN, namespace, _reference_field(to), name), ())
        return [objects[run] for run in names]

    def owned(self, uid: str) -> list[tuple[Kind, Object]]:
        """Return the objects that name an owner, with their kinds."""
        pairs = ((key.kind, self.get(key)) for key in self._owned.get(uid, ()))
        return [(kind, obj) for kind, obj in pairs if obj is not None]

    def jobs_of(self, uid: str, role: Role) -> list[Object]:
        """Return the Jobs that an owner has for a purpose."""
        owned = self.owned(uid)
        return [obj for kind, obj in owned if kind is Kind.JOB and labels_of(obj).get(Label.ROLE) == role]

    def pods_of(self, job: Object | None) -> list[Object]:
        """Return the pods of a Job, none where there is no Job."""
        owned = [] if job is None else self.owned(job["metadata"]["uid"])
        return [obj for kind, obj in owned if kind is Kind.POD]

    def narrowed(self, kind: Kind, obj: Object) -> Object:
        """Return an object narrowed: the one here if it is the same version."""
        present = self.get(key_of(kind, obj))
        if present is not None and present["metadata"].get("resourceVersion") == obj["metadata"].get(
            "resourceVersion"
        ):
            return present
        return narrow(kind, obj)

    def sync(
        self, kind: Kind, namespace: str, items: Iterable[Object], resource_version: str = ""
    ) -> list[tuple[Key, Object, bool]]:
        """Bring the store in line with a full list; returns what changed as (key, object, still there).

        Args:
            kind: the kind that was listed.
            namespace: where.
            items: the whole list, narrowed.
            resource_version: version of the list: objects newer than it are not missed in it.
        """
        listed = _number(resource_version)
        changed: list[tuple[Key, Object, bool]] = []
        seen: set[str] = set()
        for obj in items:
            key = key_of(kind, obj)
            seen.add(key.name)
            if self.put(kind, obj, narrowed=True):
                changed.append((key, obj, True))
        for name, obj in list(self._objects[kind, namespace].items()):
            # What is newer than the list is missing in it because it was made later, not because it is gone.
            if name not in seen and (not listed or version_of(obj) <= listed):
                self.remove(kind, namespace, name, obj["metadata"].get("uid"))
                changed.append((Key(kind, namespace, name), obj, False))
        return changed

    def _remember_deletion(self, uid: str) -> None:
        self._untold.pop(uid, None)
        if uid:
            self._deleted[uid] = None
            self._deleted.move_to_end(uid)
            while len(self._deleted) > _LATEST_DELETIONS:
                self._deleted.popitem(last=False)

    def _link(self, key: Key, obj: Object) -> None:
        for index in _indexes(key, obj):
            self._labelled.setdefault(index, {})[key.name] = None
        for uid in owner_uids(obj):
            self._owned.setdefault(uid, {})[key] = None

    def _unlink(self, key: Key, obj: Object) -> None:
        for index in _indexes(key, obj):
            _drop(self._labelled, index, key.name)
        for uid in owner_uids(obj):
            _drop(self._owned, uid, key)


def narrow(kind: Kind, obj: Object) -> Object:
    """Return the part of an object that the operator looks at.

    Metadata without managed fields and kubectl's annotation; Jobs without their pod template; pods as
    metadata without annotations, the node's name and the essentials of their status; ours whole.
    """
    metadata = {field: obj["metadata"][field] for field in _METADATA if field in obj["metadata"]}
    if "annotations" in metadata:
        kept = {name: value for name, value in metadata["annotations"].items() if name != _APPLIED}
        metadata["annotations"] = kept
    result: Object = {"metadata": metadata}
    if kind is Kind.POD:
        metadata.pop("annotations", None)
        result["spec"] = {"nodeName": name} if (name := obj.get("spec", {}).get("nodeName")) else {}
        result["status"] = _pod_status(obj.get("status", {}))
    elif kind is Kind.JOB:
        result["spec"] = {name: value for name, value in obj.get("spec", {}).items() if name != "template"}
        result["status"] = obj.get("status", {})
    else:
        result["spec"] = obj.get("spec", {})
        result["status"] = obj.get("status") or {}
    if len(_WORDS) > _MOST_WORDS:
        _WORDS.clear()
    shared: Object = _shared(result)
    return shared


def version_of(obj: Object) -> int:
    """Return an object's version as a number; versions of one kind can be compared."""
    return _number(obj["metadata"].get("resourceVersion", ""))


def _number(version: str) -> int:
    return int(version) if version.isdecimal() else 0


def _pod_status(status: Object) -> Object:
    result = {name: status[name] for name in _POD_STATUS if name in status}
    for name in _CONTAINERS:
        if name in status:
            result[name] = [
                {field: container[field] for field in _CONTAINER_STATUS if field in container}
                for container in status[name]
            ]
    return result


def _shared(value: Any) -> Any:
    # Thousands of objects repeat the same field names, labels and states. Written for speed: each value of
    # each event of a watch comes through here.
    kind = type(value)
    if kind is dict:
        return {_word(name): _shared(item) for name, item in value.items()}
    if kind is list:
        return [_shared(item) for item in value]
    if kind is str:
        return _WORDS.setdefault(value, value) if len(value) <= _SHORT_TEXT else value
    return _word(value) if isinstance(value, str) else value


def _word(text: str) -> str:
    plain = text if type(text) is str else str(text)  # a word of an enumeration is no plain string
    return _WORDS.setdefault(plain, plain)


_SHORT_TEXT = 32
_MOST_WORDS = 20_000
# Not sys.intern: Python 3.12 never lets go of what it was given, and each run brings some twenty words of
# its own (versions, times, names).
_WORDS: dict[str, str] = {}


def _reference_field(kind: Kind) -> str:
    return f"{kind.lower()}Ref"


def _indexes(key: Key, obj: Object) -> Iterator[_Index]:
    labels = labels_of(obj)
    for label in INDEXED_LABELS:
        value = labels.get(label)
        if value is not None:
            yield key.kind, key.namespace, str(label), value
    if key.kind is Kind.MAPPING_RUN:
        for kind in (Kind.ALGORITHM, Kind.DATASET):
            field = _reference_field(kind)
            name = (obj["spec"].get(field) or {}).get("name")
            if name is not None:
                yield key.kind, key.namespace, field, name


def _drop(index: dict[Any, dict[Any, None]], entry: Any, member: Any) -> None:
    members = index.get(entry)
    if members is not None:
        members.pop(member, None)
        if not members:
            del index[entry]
