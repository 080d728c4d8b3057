# SPDX-License-Identifier: Apache-2.0
"""Files of a gate: the baseline that it compares with, and what it says as Markdown and JUnit XML."""
