# SPDX-License-Identifier: Apache-2.0
"""The recording's doctor: faults of recordings found in all their messages, each with its repair."""
