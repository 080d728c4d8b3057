# SPDX-License-Identifier: Apache-2.0
"""Reports: figures, HTML pages and tables of several estimates."""
