# SPDX-License-Identifier: Apache-2.0
"""Small samples in the layouts of published datasets, as folders; pixels and points carry their numbers."""
