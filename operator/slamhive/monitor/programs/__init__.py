# SPDX-License-Identifier: Apache-2.0
"""Programs under a supervisor: started, logged, bounded and ended, as processes or as a container."""
