# SPDX-License-Identifier: Apache-2.0
"""What leaves the archive to stand by itself: data frames, tables for papers, a page to put beside one.

The figures are those of ``slamhive.analysis``; here they are chosen, laid out and written. Nothing in here
needs an extra but the data frames.
"""
