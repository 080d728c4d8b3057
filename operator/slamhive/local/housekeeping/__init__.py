# SPDX-License-Identifier: Apache-2.0
"""Housekeeping of a home: what takes room, what may go, and other homes that are brought in."""
