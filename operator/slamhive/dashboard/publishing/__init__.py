# SPDX-License-Identifier: Apache-2.0
"""Site without a server: the pages as files, with the answers to what they ask."""
