# SPDX-License-Identifier: Apache-2.0
"""Parts that commands share: printing, tables, questions, progress, and manifests judged to their end."""
