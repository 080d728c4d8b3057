# SPDX-License-Identifier: Apache-2.0
"""The command ``slamhive``: parses, calls, prints. Exit codes: 0, 1 something failed, 2 wrong input."""
