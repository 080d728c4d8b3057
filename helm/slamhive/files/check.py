# SPDX-License-Identifier: Apache-2.0  # noqa: INP001 - no package: the text is given to python3 -c in a pod
"""Checks of ``helm test``: the kinds are served, the operator is ready, the volumes can be written."""

from __future__ import annotations

import json
import os
import shutil
import ssl
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

ACCOUNT = Path("/var/run/secrets/kubernetes.io/serviceaccount")
KINDS = ("algorithms", "datasets", "evaluations", "mappingruns", "sweeps")
WAIT_SECONDS = 120


def get(path: str) -> Any:
    """Return the API server's answer to a GET, asked with the pod's own account."""
    host, port = os.environ["KUBERNETES_SERVICE_HOST"], os.environ["KUBERNETES_SERVICE_PORT"]
    host = f"[{host}]" if ":" in host else host
    request = urllib.request.Request(
        f"https://{host}:{port}{path}", headers={"Authorization": f"Bearer {(ACCOUNT / 'token').read_text()}"}
    )
    context = ssl.create_default_context(cafile=str(ACCOUNT / "ca.crt"))
    with urllib.request.urlopen(request, timeout=10, context=context) as answer:  # noqa: S310
        return json.load(answer)


def kinds() -> str:
    """Every kind can be listed in the namespace."""
    for kind in KINDS:
        try:
            get(f"/apis/slamhive.io/v1alpha1/namespaces/{os.environ['NAMESPACE']}/{kind}?limit=1")
        except urllib.error.HTTPError as error:
            hint = "install the chart slamhive-crds" if error.code == 404 else error.reason
            raise RuntimeError(f"{kind}.slamhive.io: {hint}") from None
    return "kinds: all served"


def operator() -> str:
    """The operator's Deployment has a ready pod of its newest version."""
    path = f"/apis/apps/v1/namespaces/{os.environ['NAMESPACE']}/deployments/{os.environ['OPERATOR']}"
    deadline = time.monotonic() + WAIT_SECONDS
    while True:
        found = get(path)
        status = found.get("status", {})
        newest = status.get("observedGeneration") == found["metadata"]["generation"]
        if newest and status.get("readyReplicas", 0) >= 1 and status.get("updatedReplicas", 0) >= 1:
            return "operator: ready"
        if time.monotonic() > deadline:
            raise RuntimeError(f"operator: not ready, see kubectl logs deployment/{os.environ['OPERATOR']}")
        time.sleep(1)


def volume(folder: str) -> str:
    """A folder can be made, written, read and removed by the user that runs have."""
    place = Path(folder) / f".helm-test-{os.environ['HOSTNAME']}"
    try:
        place.mkdir(parents=True)
        (place / "file").write_text("written")
        if (place / "file").read_text() != "written":
            raise RuntimeError(f"{folder}: reads back something else than was written")
    except OSError as error:
        raise RuntimeError(f"{folder}: user {os.getuid()} can't write it: {error.strerror}") from None
    finally:
        shutil.rmtree(place, ignore_errors=True)
    return f"{folder}: writable by user {os.getuid()}, {shutil.disk_usage(folder).free / 2**30:.1f} GiB free"


def main() -> int:
    """Check everything and say what was found; 1 if something is wrong."""
    checks = [kinds, operator, *((lambda f=f: volume(f)) for f in os.environ["FOLDERS"].split(":"))]
    wrong = 0
    for check in checks:
        try:
            print("ok   ", check(), flush=True)  # noqa: T201
        except (RuntimeError, OSError) as error:
            print("WRONG", error, flush=True)  # noqa: T201
            wrong = 1
    return wrong


sys.exit(main())
