# SPDX-License-Identifier: Apache-2.0
"""The version of the preparation, for those who name variants without making any."""

VERSION = 1
"""Raised when preparation makes something else of the same input: part of keys and content hashes."""
