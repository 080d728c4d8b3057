# SPDX-License-Identifier: Apache-2.0
"""Datasets: reading and checking recordings, importing them, generating synthetic ones, preparing variants."""
