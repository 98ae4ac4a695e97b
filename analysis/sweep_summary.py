"""A sweep's table in a few lines: the least, the median and the greatest of every metric, and where to find them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clikgen.analysis.summary import UNITS
from clikgen.analysis.sweep import Sweep

_UNITS = UNITS | {"diverged_at": "s"}


def summary_document(sweep: Sweep, measured: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """What was run, and what every metric was; None where no rollout has one."""
    return {
        "scenario": sweep.scenario.name,
        "controller": sweep.controller.manifest.controller,
        "rollouts": sweep.file.count,
        "axes": [axis.key for axis in sweep.file.axes],
        "metrics": {name: {**_spread(column), "unit": _UNITS.get(name, "")} for name, column in measured.items()},
    }


def _spread(column: NDArray[Any]) -> dict[str, Any]:
    """Of the rollouts that have the metric; `undefined` counts the others."""
    rows = np.flatnonzero(np.isfinite(column))
    at = rows[np.argsort(column[rows], kind="stable")]
    places = {"least": 0, "median": (rows.size - 1) // 2, "greatest": rows.size - 1}
    spread: dict[str, Any] = {}
    for name, place in places.items():
        spread[name] = column[at[place]].item() if rows.size else None
        spread[f"{name}_index"] = int(at[place]) if rows.size else None
    return {**spread, "undefined": len(column) - rows.size}


def summary_table(document: Mapping[str, Any]) -> tuple[str, list[str], list[list[str]]]:
    """Title, column heads and rows: a metric a row; every value with the index of its rollout."""
    rows = []
    for name, spread in document["metrics"].items():
        row = [name, *(_figure(spread, key) for key in ("least", "median", "greatest")), spread["unit"]]
        rows.append([*row, str(spread["undefined"]) if spread["undefined"] else ""])
    heads = ["metric", "least", "median", "greatest", "unit", "undefined"]
    if not any(row[-1] for row in rows):
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    title = f"{document['scenario']} on {document['controller']}: {document['rollouts']:,} rollouts"
    return title, heads, rows


def _figure(spread: dict[str, Any], key: str) -> str:
    value = spread[key]
    if value is None:
        return "-"
    return f"{value if isinstance(value, int) else f'{value:.4g}'} (#{spread[f'{key}_index']})"
