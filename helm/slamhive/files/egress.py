# SPDX-License-Identifier: Apache-2.0  # noqa: INP001 - no package: the text is given to python3 -c in a pod
"""Network check of ``helm test``, in a pod like those of runs: it reaches nothing that runs must not."""

from __future__ import annotations

import os
import socket
import sys

SECONDS = 5.0


def reached(host: str, port: int) -> bool:
    """Tell whether a connection can be made."""
    try:
        socket.create_connection((host, port), SECONDS).close()
    except OSError:
        return False
    return True


def main() -> int:
    """Try to reach what no algorithm may; always 0, as not every network can keep it from there."""
    host, port = os.environ["KUBERNETES_SERVICE_HOST"], os.environ["KUBERNETES_SERVICE_PORT"]
    places = [("the API server", host, port)]
    if os.environ.get("DASHBOARD"):
        places.append(("the dashboard, and by it ground truth", *os.environ["DASHBOARD"].rsplit(":", 1)))
    open_ones = [what for what, host, port in places if reached(host, int(port))]
    for what in open_ones:
        print(  # noqa: T201
            f"OPEN  runs reach {what}: this cluster's network does not enforce NetworkPolicies", flush=True
        )
    if not open_ones:
        print("ok    runs reach neither API server nor dashboard", flush=True)  # noqa: T201
    return 0


sys.exit(main())
