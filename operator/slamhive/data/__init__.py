# SPDX-License-Identifier: Apache-2.0
"""Datasets: recordings read and checked, imported, generated, and prepared for runs."""
