# SPDX-License-Identifier: Apache-2.0
"""Exports of the archive that stand by themselves: data frames, tables for papers, and the static report.

The figures are those of ``slamhive.analysis``; here they are chosen, laid out and written. Nothing in here
needs an extra but the data frames.
"""
