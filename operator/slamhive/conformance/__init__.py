# SPDX-License-Identifier: Apache-2.0
"""Conformance of algorithms: each is started on short recordings, and held against the contract.

``slamhive algorithm check`` prints what is found. Nothing of it goes into an archive.
"""
