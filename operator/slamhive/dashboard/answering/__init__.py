# SPDX-License-Identifier: Apache-2.0
"""Answering of the dashboard's questions: worker processes, their budgets, and answers as bytes."""
