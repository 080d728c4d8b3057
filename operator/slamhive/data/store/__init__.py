# SPDX-License-Identifier: Apache-2.0
"""Datasets on this machine: made, added, obtained by name, with their ground truth."""
