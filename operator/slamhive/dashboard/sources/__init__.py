# SPDX-License-Identifier: Apache-2.0
"""Sources of the dashboard's data: archives, homes, and a cluster's live objects."""
