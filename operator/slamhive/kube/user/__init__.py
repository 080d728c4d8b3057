# SPDX-License-Identifier: Apache-2.0
"""Client side of the cluster commands: submit, look, read logs, cancel, fetch. Nothing here prints.

``slamhive submit | status | logs | cancel | fetch`` call this; the operator does not. It needs the client for
Kubernetes (``slamhive[cluster]``), and nothing of kopf.
"""
