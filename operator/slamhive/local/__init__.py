# SPDX-License-Identifier: Apache-2.0
"""Running sweeps on a workstation: the engine's executor for processes on this machine."""
