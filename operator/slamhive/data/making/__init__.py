# SPDX-License-Identifier: Apache-2.0
"""Making of recordings and folders from a dataset: variants for runs, exports for anyone."""
