# SPDX-License-Identifier: Apache-2.0
"""The one error of the test cluster."""

from __future__ import annotations


class ClusterError(Exception):
    """Error of the test cluster: what is missing or went wrong, in a sentence."""
