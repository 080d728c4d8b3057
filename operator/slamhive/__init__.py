# SPDX-License-Identifier: Apache-2.0
"""SLAM Hive: compare SLAM algorithms on a workstation or on Kubernetes."""

__version__ = "0.1.0"
