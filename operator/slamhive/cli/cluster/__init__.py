# SPDX-License-Identifier: Apache-2.0
"""Commands for a cluster: submit, status, logs, cancel, fetch, and runs as if it were this machine."""
