# SPDX-License-Identifier: Apache-2.0
"""Commands that share studies: bundles made and verified, and runs of somebody else brought in."""
