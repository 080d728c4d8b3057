#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The project's own Kubernetes for tests: `python tests/cluster/cluster.py --help`. Standard library only."""

from __future__ import annotations

import sys

from testcluster.command import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
