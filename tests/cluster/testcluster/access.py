# SPDX-License-Identifier: Apache-2.0
"""A cluster as tests see it: its kubeconfig, kubectl, and waiting with a deadline."""

from __future__ import annotations

import base64
import json
import os
import ssl
import subprocess
import tempfile
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from testcluster.errors import ClusterError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path


@dataclass(frozen=True)
class Cluster:
    """A cluster that answers.

    Attributes:
        mode: local, kind or current.
        kubeconfig: the administrator's kubeconfig.
        kubectl_path: the kubectl to use.
        loader: puts an image built on this machine into the cluster, by its name.
        instance: name of a local cluster, None for others.
    """

    mode: str
    kubeconfig: Path
    kubectl_path: str
    loader: Callable[[str], None]
    instance: str | None = None

    @property
    def environment(self) -> dict[str, str]:
        """Environment for programs that find the cluster by KUBECONFIG."""
        return os.environ | {"KUBECONFIG": str(self.kubeconfig)}

    def run(
        self, *arguments: str, stdin: str | None = None, timeout: float = 300
    ) -> subprocess.CompletedProcess[str]:
        """Run kubectl and return what came of it, whatever that is."""
        return subprocess.run(
            [self.kubectl_path, *arguments],
            input=stdin,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )

    def kubectl(self, *arguments: str, stdin: str | None = None, timeout: float = 300) -> str:
        """Run kubectl and return its output.

        Raises:
            ClusterError: it failed; the message is kubectl's.
        """
        result = self.run(*arguments, stdin=stdin, timeout=timeout)
        if result.returncode:
            raise ClusterError(f"kubectl {' '.join(arguments)}: {result.stderr.strip()}")
        return result.stdout

    def server(self) -> tuple[str, ssl.SSLContext]:
        """Return the API server's address and the administrator's way in, for who asks often or forges."""
        view = json.loads(self.kubectl("config", "view", "--flatten", "--minify", "-o", "json"))
        (cluster,), (user,) = view["clusters"], view["users"]

        def text(holder: dict[str, str], name: str) -> str:
            return base64.b64decode(holder[f"{name}-data"]).decode()

        context = ssl.create_default_context(cadata=text(cluster["cluster"], "certificate-authority"))
        with tempfile.NamedTemporaryFile("w") as file:  # it takes no certificate but from a file
            file.write(text(user["user"], "client-certificate") + text(user["user"], "client-key"))
            file.flush()
            context.load_cert_chain(file.name)
        return cluster["cluster"]["server"], context

    def get(self, *arguments: str) -> Any:
        """Return objects as kubectl get gives them."""
        return json.loads(self.kubectl("get", *arguments, "-o", "json"))

    def apply(self, *objects: dict[str, Any], namespace: str | None = None) -> None:
        """Apply objects on the server's side."""
        where = ["-n", namespace] if namespace else []
        body = json.dumps({"apiVersion": "v1", "kind": "List", "items": objects})
        self.kubectl("apply", "--server-side", "--force-conflicts", *where, "-f", "-", stdin=body)

    def apply_files(self, paths: Iterable[Path], *more: str) -> None:
        """Apply manifest files on the server's side."""
        files = [argument for path in paths for argument in ("-f", str(path))]
        self.kubectl("apply", "--server-side", "--force-conflicts", *more, *files)

    def await_kinds(self, names: Iterable[str]) -> None:
        """Wait until kinds are served, by the names of their definitions.

        ``kubectl wait`` fails at once while a definition that was just made has no conditions.
        """
        for name in names:
            until(lambda name=name: self._is_established(name), f"{name} to be served")

    def _is_established(self, name: str) -> bool:
        conditions = self.get("customresourcedefinition", name).get("status", {}).get("conditions") or []
        return any(one["type"] == "Established" and one["status"] == "True" for one in conditions)

    def patch(
        self, kind: str, name: str, change: dict[str, Any], namespace: str, subresource: str = ""
    ) -> None:
        """Change an object by a JSON merge patch."""
        where = ["-n", namespace, *([f"--subresource={subresource}"] if subresource else [])]
        self.kubectl("patch", kind, name, *where, "--type=merge", "-p", json.dumps(change))

    def delete(self, kind: str, name: str, namespace: str) -> None:
        """Delete an object, without waiting for what it owns."""
        self.kubectl("delete", kind, name, "-n", namespace, "--wait=false")

    def load(self, image: str) -> None:
        """Put an image that was built on this machine into the cluster."""
        self.loader(image)


def until(condition: Callable[[], Any], what: str, seconds: float = 180, pause: float = 0.2) -> Any:
    """Return the condition's first true value.

    The longer it takes, the longer are the pauses: a kubectl needs a seventh of a second of processor time.

    Raises:
        ClusterError: it had none by the deadline; the message says what was waited for.
    """
    begin = time.monotonic()
    while not (value := condition()):
        waited = time.monotonic() - begin
        if waited > seconds:
            raise ClusterError(f"gave up after {seconds:g} s waiting for {what}")
        time.sleep(max(pause, min(waited / 20, 1)))
    return value
