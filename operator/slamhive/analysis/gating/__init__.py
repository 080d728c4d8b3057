# SPDX-License-Identifier: Apache-2.0
"""Gate: whether new runs are no worse than recorded ones, decided as they come in, with few false alarms."""
