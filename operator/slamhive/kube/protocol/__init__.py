# SPDX-License-Identifier: Apache-2.0
"""Requests to the programs in our pods, and the lines that they answer in."""
