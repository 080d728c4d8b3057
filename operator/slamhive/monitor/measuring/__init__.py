# SPDX-License-Identifier: Apache-2.0
"""Measuring of CPU and memory: the kernel's accounts of a cgroup or of a tree of processes."""
