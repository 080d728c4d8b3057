# SPDX-License-Identifier: Apache-2.0
"""Trajectories and their errors."""
