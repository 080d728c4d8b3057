# SPDX-License-Identifier: Apache-2.0
"""Figures for papers: what a question comes to, as marks on shared axes, and matplotlib that draws them."""
