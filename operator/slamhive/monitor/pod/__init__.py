# SPDX-License-Identifier: Apache-2.0
"""Parts of the sidecar that watches an algorithm's container from beside it, in a run's pod."""
