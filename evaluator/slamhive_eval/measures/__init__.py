# SPDX-License-Identifier: Apache-2.0
"""Measures beyond ATE and RPE: challenges, maps, motion, control points, relations, repetitions."""
