# SPDX-License-Identifier: Apache-2.0
"""Meta analysis over results, pure: a table of runs is selected from, grouped and averaged.

Commands, pages, reports and data frames use the same functions, so that all mean the same by a column, a
condition or a mean.
"""

from slamhive.analysis.expressions import ExpressionError, parse_where
from slamhive.analysis.frame import Frame
from slamhive.analysis.grouping import Outcomes, aggregate, varying
from slamhive.analysis.metrics import Metric
from slamhive.analysis.selection import Selection, choose
from slamhive.analysis.statistics import Summary

__all__ = [
    "ExpressionError",
    "Frame",
    "Metric",
    "Outcomes",
    "Selection",
    "Summary",
    "aggregate",
    "choose",
    "parse_where",
    "varying",
]
