# SPDX-License-Identifier: Apache-2.0
"""The operator: custom resources become Jobs, and what their pods tell becomes status."""
