# SPDX-License-Identifier: Apache-2.0
"""Run folders in object storage: what was moved there, and how its files are read."""
