# SPDX-License-Identifier: Apache-2.0
"""The operator's own entry point, which the kernel kills at the n-th of its writes (0: never).

The logs of evaluators are played, because their pods are.
"""

from __future__ import annotations

import os
import signal
import sys

from faultlab.arena import played_logs
from faultlab.points import WRITES

from slamhive.kube import __main__ as program
from slamhive.kube.api.client import Api


class Death:
    """Kills this process at a write."""

    def __init__(self, number: int) -> None:
        self._left = number

    def __call__(self, moment: str, verb: str, resource: str) -> None:
        """Count a call."""
        del resource
        if verb in WRITES and moment == "after":
            self._left -= 1
            if self._left == 0:
                os.kill(os.getpid(), signal.SIGKILL)


class DyingApi(Api):
    """The API with that death in it."""

    logs = played_logs

    def __init__(self, *arguments: object, **options: object) -> None:
        super().__init__(*arguments, fault=Death(int(os.environ["SLAMHIVE_TEST_DEATH"])), **options)


program.Api = DyingApi
sys.exit(program.main())
