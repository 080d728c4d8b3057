# SPDX-License-Identifier: Apache-2.0
"""The contract of a run: what an algorithm leaves behind, and how it is read, judged and bounded.

The supervisor on a workstation, the monitor in a pod, the operator and the evaluators read through here, so
that the same files mean the same wherever a run ran. Standard library alone, as the monitor is.
"""
