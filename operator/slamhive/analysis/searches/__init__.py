# SPDX-License-Identifier: Apache-2.0
"""Searches: runs as their decisions see them, thresholds that were found, and the robustness of systems."""
