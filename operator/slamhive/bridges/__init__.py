# SPDX-License-Identifier: Apache-2.0
"""Bridges: finished runs written for other programs, by the libraries of those programs."""
