# SPDX-License-Identifier: Apache-2.0
"""Formats of files: trajectories, tables, bags, clouds and transforms, read and written."""
