# SPDX-License-Identifier: Apache-2.0
"""Home of a workstation: its folder, catalog, leases, and what is known of its runs and sweeps."""
