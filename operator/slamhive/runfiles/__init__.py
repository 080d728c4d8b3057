# SPDX-License-Identifier: Apache-2.0
"""Files of runs: found where they lie, read within bounds, on clocks that are comparable."""
