# SPDX-License-Identifier: Apache-2.0
"""Connection to a cluster: finds kubeconfig, context and namespace, and checks that the CRDs are there."""

from __future__ import annotations

import os
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from kubernetes.aio.config import ConfigException, list_kube_config_contexts

from slamhive.kube.api.errors import Forbidden, ServerFault, Unauthorized
from slamhive.kube.api.kinds import OUR_KINDS, Key, Kind
from slamhive.kube.api.transport import NAMESPACE_OF_POD
from slamhive.kube.user.api import UserApi
from slamhive.model.base import GROUP, VERSION
from slamhive.model.errors import SlamHiveError, UnknownNameError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator


class ClusterError(SlamHiveError):
    """The cluster cannot be used: the sentence says why, and how to change that."""

    reason = "ClusterUnusable"


@dataclass(frozen=True)
class Target:
    """Cluster and namespace that a command works in, by kubeconfig and context.

    Attributes:
        kubeconfig: the kubeconfig, or several as in KUBECONFIG; None inside a pod.
        context: its context; None inside a pod.
        namespace: the namespace.
    """

    kubeconfig: Path | None
    context: str | None
    namespace: str


@dataclass(frozen=True)
class ConnectedCluster:
    """A cluster that answers and knows our kinds.

    Attributes:
        api: the way there.
        target: where that is.
    """

    api: UserApi
    target: Target

    @property
    def namespace(self) -> str:
        """Return the namespace that the command works in."""
        return self.target.namespace

    def key(self, kind: Kind, name: str) -> Key:
        """Return the address of an object of the namespace."""
        return Key(kind, self.namespace, name)


def find_target(context: str | None, namespace: str | None) -> Target:
    """Return the cluster that the options and the kubeconfig mean, as kubectl would take them.

    Args:
        context: name of a context; default: the current one.
        namespace: name of a namespace; default: that of the context, or ``default``.

    Raises:
        ClusterError: there is no kubeconfig, or it cannot be used.
        UnknownNameError: it has no such context.
    """
    files = os.environ.get("KUBECONFIG") or str(Path("~/.kube/config").expanduser())
    if not any(Path(file).is_file() for file in files.split(os.pathsep)):
        # In a pod without a kubeconfig the command works with the pod's own account, as kubectl does.
        if NAMESPACE_OF_POD.is_file() and context is None:
            return Target(None, None, namespace or NAMESPACE_OF_POD.read_text(encoding="utf-8").strip())
        raise ClusterError(f"no cluster is known: there is no file {files}; set KUBECONFIG")
    contexts, current = _contexts(files)
    chosen = context or (current or {}).get("name")
    if chosen is None:
        raise ClusterError(f"{files}: no current context; kubectl config use-context NAME, or --context")
    if chosen not in contexts:
        raise UnknownNameError("context", chosen, contexts, "--context")
    return Target(Path(files), chosen, namespace or contexts[chosen].get("namespace") or "default")


@asynccontextmanager
async def connected(target: Target) -> AsyncIterator[ConnectedCluster]:
    """Be connected to a cluster that has our kinds.

    Raises:
        ClusterError: it does not answer, does not know the user, or lacks our CRDs.
    """
    api = await UserApi.connect(target.kubeconfig, target.context)
    try:
        await _check(api, target)
        yield ConnectedCluster(api, target)
    finally:
        await api.close()


async def _check(api: UserApi, target: Target) -> None:
    where = f"the cluster of context {target.context!r}" if target.context else "this pod's cluster"
    try:
        served = await api.served(GROUP, VERSION)
    except ServerFault as error:
        raise ClusterError(f"{where} does not answer: {error}") from None
    except (Unauthorized, Forbidden) as error:
        raise ClusterError(f"{where} does not let this user in: {error}") from None
    missing = sorted(str(kind) for kind in OUR_KINDS if kind.plural not in served)
    if missing:
        raise ClusterError(
            f"{where} does not know {', '.join(missing)} of {GROUP}/{VERSION}: "
            "its administrator installs the charts slamhive-crds and slamhive"
        )


def _contexts(files: str) -> tuple[dict[str, dict[str, Any]], dict[str, Any] | None]:
    """Return the contexts of a kubeconfig by name, and the current one."""
    try:
        found, current = list_kube_config_contexts(files)  # type: ignore[no-untyped-call]
    except ConfigException as error:
        # A kubeconfig without a current context is usual, and has a remedy of its own.
        if "current-context" not in str(error):
            raise ClusterError(f"{files}: {error}") from None
        raise ClusterError(
            f"{files}: no current context; kubectl config use-context NAME chooses one"
        ) from None
    except (yaml.YAMLError, OSError, UnicodeDecodeError, AttributeError, TypeError) as error:
        said = str(error).splitlines()[0]
        raise ClusterError(f"{files}: not a kubeconfig: {said}") from None
    return {item["name"]: item.get("context") or {} for item in found}, current
