# SPDX-License-Identifier: Apache-2.0
"""Meta analysis over results, pure: records become rows, rows are selected, grouped and averaged.

``slamhive results`` and the dashboard use the same functions, so that both mean the same by a column,
a condition or a mean.
"""

from slamhive.analysis.expressions import ExpressionError, compile_where
from slamhive.analysis.flattening import CORE_COLUMNS, columns_of, flatten
from slamhive.analysis.metrics import Metric
from slamhive.analysis.ordering import order_by
from slamhive.analysis.pivot import Group, Outcomes, PivotTable, Summary, table, varying

__all__ = [
    "CORE_COLUMNS",
    "ExpressionError",
    "Group",
    "Metric",
    "Outcomes",
    "PivotTable",
    "Summary",
    "columns_of",
    "compile_where",
    "flatten",
    "order_by",
    "table",
    "varying",
]
