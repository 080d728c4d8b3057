# SPDX-License-Identifier: Apache-2.0
"""Exit codes of the commands: 0 when all went well, and these."""

FAILED = 1
WRONG_INPUT = 2
UNKNOWN = 3  # slamhive gate: nobody can tell
WORSE = 4  # slamhive gate: worse than before
INTERRUPTED = 130
