# SPDX-License-Identifier: Apache-2.0
"""Operators that work on a real control plane, in a namespace of the test's own, on played nodes."""

from __future__ import annotations

from testcluster.labs import *  # noqa: F403
