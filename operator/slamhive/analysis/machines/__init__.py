# SPDX-License-Identifier: Apache-2.0
"""Machines: whether nodes of the same kind measure the same load of the same runs."""
