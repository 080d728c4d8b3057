# SPDX-License-Identifier: Apache-2.0
"""Server of the dashboard: addresses, pages, connections, and the service between them and the answers."""
