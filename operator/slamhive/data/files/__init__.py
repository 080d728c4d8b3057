# SPDX-License-Identifier: Apache-2.0
"""Files: fetched, unpacked, made once, removed; what every other part of the data needs of a disk."""
