# SPDX-License-Identifier: Apache-2.0
"""The sampler of a search: proposes settings by what is known of those before, in a process of its own."""

from slamhive.sampling.sampler import Proposer, Sampler, require_sampler

__all__ = ["Proposer", "Sampler", "require_sampler"]
