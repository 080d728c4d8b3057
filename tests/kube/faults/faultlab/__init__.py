# SPDX-License-Identifier: Apache-2.0
"""Means to break operators on purpose, many at a time, each in a namespace of its own."""
