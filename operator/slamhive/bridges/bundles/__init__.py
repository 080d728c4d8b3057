# SPDX-License-Identifier: Apache-2.0
"""Bundles: a study in a file that others verify, repeat and import, without its recordings."""
