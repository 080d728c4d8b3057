# SPDX-License-Identifier: Apache-2.0
"""Builders: from our objects to the manifests of Jobs. Pure: no API, no clock, no volume."""

from slamhive.kube.builders.common import ANNOTATION_LIMIT, label, label_value
from slamhive.kube.builders.evaluation import batches, evaluator_job, evaluator_job_name, read_job
from slamhive.kube.builders.run import Companion, configuration, job_name, run_job
from slamhive.kube.builders.variant import variant_job, variant_job_name, variant_name

__all__ = [
    "ANNOTATION_LIMIT",
    "Companion",
    "batches",
    "configuration",
    "evaluator_job",
    "evaluator_job_name",
    "job_name",
    "label",
    "label_value",
    "read_job",
    "run_job",
    "variant_job",
    "variant_job_name",
    "variant_name",
]
