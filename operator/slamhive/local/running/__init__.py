# SPDX-License-Identifier: Apache-2.0
"""Runs of a workstation, from the window of a sweep to a measured result, and what they will cost."""
