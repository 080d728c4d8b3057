# SPDX-License-Identifier: Apache-2.0
"""The dashboard: what was run and what came out, over HTTP, without any way to change it."""
