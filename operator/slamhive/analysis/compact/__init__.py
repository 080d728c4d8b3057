# SPDX-License-Identifier: Apache-2.0
"""Compact forms: what documents of many runs have in common held once, and many texts as one array."""
