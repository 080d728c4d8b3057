# SPDX-License-Identifier: Apache-2.0
"""The language: the five kinds, the unified configuration and the records of results.

Pure data: everything else imports this package, and it imports nothing of slamhive.
"""
