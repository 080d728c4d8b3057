# SPDX-License-Identifier: Apache-2.0
"""Exit codes of the commands: 0 when all went well, and these."""

FAILED = 1
WRONG_INPUT = 2
INTERRUPTED = 130
