# SPDX-License-Identifier: Apache-2.0
"""The table of runs: loaded from the archive, selected by query strings, written as text."""
