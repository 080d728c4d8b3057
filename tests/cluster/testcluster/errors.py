# SPDX-License-Identifier: Apache-2.0
"""The one error of the test cluster."""

from __future__ import annotations


class ClusterError(Exception):
    """What is missing or went wrong, in a sentence."""
