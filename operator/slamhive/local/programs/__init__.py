# SPDX-License-Identifier: Apache-2.0
"""Programs of a workstation: environments and containers of algorithms, cores, players, supervision."""
