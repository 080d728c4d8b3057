# SPDX-License-Identifier: Apache-2.0
"""Inspection of recordings: faults, first manifests, and what is drawn of them."""
