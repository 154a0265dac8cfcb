"""The report of a campaign: outcomes, success rate, percentiles, worst runs and errors."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from ffsms_pin.analysis import finite, wilson_interval

_PERCENTILES = (5, 25, 50, 75, 95, 99)
_SHOWN = ("seed", "outcome", "error")  # columns in the list of worst runs, besides distances


def by_method(table: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the tables by method if the campaign compares methods, otherwise the table under ""."""
    columns = dict(table)
    methods = columns.pop("method", np.full(len(table["seed"]), "", object))
    names = dict.fromkeys(methods.tolist())
    return {name: {key: values[methods == name] for key, values in columns.items()} for name in names}


def report(table: dict[str, Any]) -> dict[str, Any]:
    """Return the report of a table of runs for JSON, by method if the campaign compares methods.

    The ten worst runs are first those that failed or were stopped or killed, then those with the largest
    error.
    """
    if "method" in table:
        return {method: report(part) for method, part in by_method(table).items()}
    outcomes, errors = Counter(table["outcome"].tolist()), Counter(filter(None, table["error"].tolist()))
    runs, arrived = outcomes.total(), outcomes["arrived"]
    unfinished = ~np.isin(table["outcome"], ("arrived", "missed"))
    measures = [name for name in ("final_error_m", "path_error_max_m") if name in table]
    worst = np.lexsort((-np.nan_to_num(table[measures[-1]], nan=np.inf), ~unfinished))[:10]
    return {
        "runs": runs,
        "outcomes": dict(outcomes.most_common()),
        "success_rate": arrived / runs,
        "success_rate_95_percent": list(wilson_interval(arrived, runs)),
        "percentiles": {
            name: dict(zip(_PERCENTILES, np.nanpercentile(values, _PERCENTILES).tolist(), strict=True))
            for name, values in table.items()
            if values.dtype.kind == "f" and not name.startswith("draw.") and np.isfinite(values).any()
        },
        "worst": [
            {name: finite(table[name][i]) for name in measures}
            | {name: table[name].tolist()[i] for name in _SHOWN}
            for i in worst
        ],
        "errors": dict(errors.most_common(5)),
    }
