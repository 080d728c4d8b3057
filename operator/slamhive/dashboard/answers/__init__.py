# SPDX-License-Identifier: Apache-2.0
"""Answers of the API, one module a subject: from a question and the table to numbers and words."""
