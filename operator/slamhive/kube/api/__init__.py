# SPDX-License-Identifier: Apache-2.0
"""Kubernetes API as we use it: calls, watches, kinds of objects, errors by their meaning."""
