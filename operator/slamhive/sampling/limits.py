# SPDX-License-Identifier: Apache-2.0
"""Limits of the process that proposes settings."""

CPU_SECONDS = 120
"""Processor time of a proposal; of 5,000 trials one takes a second."""
MEMORY_BYTES = 1 << 30
"""Memory beyond that of a Python that has imported nothing; 5,000 trials take a tenth."""
WALL_SECONDS = 600.0
"""Time until an answer, after which the process is taken to stand still."""
