# SPDX-License-Identifier: Apache-2.0
"""Recordings: read and written in three formats, and the messages that are in them."""
