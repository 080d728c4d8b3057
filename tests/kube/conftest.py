# SPDX-License-Identifier: Apache-2.0
"""The cluster's fixtures for tests that talk to an API server."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "cluster"))

from testcluster.fixtures import *  # noqa: F403
