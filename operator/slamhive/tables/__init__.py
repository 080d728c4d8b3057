# SPDX-License-Identifier: Apache-2.0
"""The table of runs as everybody gets it: loaded from the archive, asked for in words, written as text."""
