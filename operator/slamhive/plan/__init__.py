# SPDX-License-Identifier: Apache-2.0
"""Plan: from a Sweep to its runs, lazily, with names and hashes that are the same everywhere. Pure."""

from slamhive.plan.catalog import Catalog, FixedCatalog
from slamhive.plan.checks import impossible, plan_problems
from slamhive.plan.configuration import run_configuration, whole_cores
from slamhive.plan.effects import Effect, option_problems, recording_fields
from slamhive.plan.expansion import Plan, Point
from slamhive.plan.hashes import algorithm_hash, content_hash, local_uid, run_name, spec_hash
from slamhive.plan.images import image_digest, pinned_digest
from slamhive.plan.resolution import resolve
from slamhive.plan.searching import SearchPlan, SearchSpace, plan_of, probed

__all__ = [
    "Catalog",
    "Effect",
    "FixedCatalog",
    "Plan",
    "Point",
    "SearchPlan",
    "SearchSpace",
    "algorithm_hash",
    "content_hash",
    "image_digest",
    "impossible",
    "local_uid",
    "option_problems",
    "pinned_digest",
    "plan_of",
    "plan_problems",
    "probed",
    "recording_fields",
    "resolve",
    "run_configuration",
    "run_name",
    "spec_hash",
    "whole_cores",
]
