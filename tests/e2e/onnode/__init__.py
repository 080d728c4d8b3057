# SPDX-License-Identifier: Apache-2.0
"""What end-to-end tests need: a team's namespace, documents' commands, Prometheus, the node's account."""
