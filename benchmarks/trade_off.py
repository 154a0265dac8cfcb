"""Measure cost, base rotation and joint travel for different weights of `opt.BaseTurn` and `opt.Effort`.

`python benchmarks/trade_off.py --targets 10 --figure docs/images/trade-off.png` draws the figure of the docs.
The targets are those of `motions.py`. The figure has medians; base rotation and joint travel are divided by
those of the resolved-rate move for each target. `--draw` draws the numbers of an earlier run.
"""

from __future__ import annotations

import argparse
import json
from itertools import islice
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from motions import DT, DURATION, measured, tasks

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.files import write_content
from ffsms_pin.opt.plans import PlanOptions
from ffsms_pin.plotting.style import applied, line

BASE = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0)  # weights of opt.BaseTurn, with the default effort
EFFORT = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # weights of opt.Effort, without opt.BaseTurn
NUMBERS = ("cost", "turn", "travel")
FAMILIES = ("base", "effort")
# Weights with labels in the figure; the labels of other weights would overlap.
LABELLED = {"base": BASE[5:], "effort": (1e-2, 1.0)}
OTHERS = {"step": 'method="step"', "resolved-rate": 'method="resolved-rate"'}


def planned(
    sms: ffsms.SpaceManipulator, q0: Any, target: Any, **weights: Unpack[PlanOptions]
) -> dict[str, float]:
    """Return cost [s], base rotation [rad] and joint travel [rad] of one plan."""
    plan = opt.plan(sms, q0, target, DURATION, DT, **weights)
    return {
        "reached": float(plan.reached),
        "cost": plan.cost_integral,
        "turn": float(plan.base_rotation.max()),
        "travel": plan.joint_travel,
    }


def measure(name: str, count: int, seed: int) -> dict[str, dict[str, float]]:
    """Return medians over targets for each setting, such as "base 0.1"; `turn` and `travel` are ratios."""
    sms = ffsms.load(name)
    found: dict[str, list[dict[str, float]]] = {}
    for q0, target, straight in islice(tasks(sms, seed), count):
        rows = {"resolved-rate": straight, "step": measured(sms, q0, target, "step")}
        rows.update({f"base {weight:g}": planned(sms, q0, target, base=weight) for weight in BASE})
        rows.update({f"effort {weight:g}": planned(sms, q0, target, effort=weight) for weight in EFFORT})
        for setting, row in rows.items():
            ratios = {key: row[key] / straight[key] for key in ("turn", "travel")}
            found.setdefault(setting, []).append({**row, **ratios})
    return {
        setting: {key: float(np.median([row[key] for row in rows])) for key in NUMBERS}
        | {"reached": sum(row["reached"] for row in rows), "targets": float(len(rows))}
        for setting, rows in found.items()
    }


def draw(results: dict[str, dict[str, dict[str, float]]], path: Path) -> None:
    """Draw cost and joint travel over the base's rotation, with one column for each arm."""
    from matplotlib.figure import Figure

    with applied():
        figure = Figure(figsize=(4.2 * len(results), 5.6), layout="constrained")
        axes = figure.subplots(2, len(results), sharex="col", sharey="row", squeeze=False)
        for column, (name, found) in enumerate(results.items()):
            for row, key in enumerate(("cost", "travel")):
                ax = axes[row, column]
                _families(ax, found, key)
                ax.set_title(name if row == 0 else "", fontsize=9.0)
            axes[0, column].set_yscale("log")
            axes[1, column].set_xlabel("base turn / that of resolved-rate")
        axes[0, 0].set_ylabel("cost integral [s]")
        axes[1, 0].set_ylabel("joint travel / that of resolved-rate")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
        figure.savefig(path, dpi=110, metadata={"Software": None})


def _families(ax: Any, found: dict[str, dict[str, float]], key: str) -> None:
    for i, family in enumerate(FAMILIES):
        settings = [name for name in found if name.split()[0] == family]
        x, y = ([found[name][k] for name in settings] for k in ("turn", key))
        ax.plot(x, y, marker="o", markersize=4.0, label=f"opt.plan({family}=...)", **line(i))
        for name, at, height in zip(settings, x, y, strict=True):
            weight = float(name.split()[1])
            if key != "travel" or weight not in LABELLED[family]:
                continue
            side = -1 if weight == EFFORT[-1] and family == "effort" else 1
            aside = (5 * side, 4 if family == "base" else -3)
            ax.annotate(
                f"{weight:g}",
                (at, height),
                xytext=aside,
                textcoords="offset points",
                ha="left" if side > 0 else "right",
                fontsize=7.0,
                color=line(i)["color"],
            )
    for (name, label), marker in zip(OTHERS.items(), "sD", strict=True):
        medians = found[name]
        style = {"marker": marker, "linestyle": "none", "color": "#555555"}
        ax.plot([medians["turn"]], [medians[key]], label=label, **style)


def table(results: dict[str, dict[str, dict[str, float]]]) -> str:
    """Return a Markdown table of the medians."""
    lines = ["| arm | setting | reached | cost [s] | base rotation | joint travel |", "|" + "---|" * 6]
    for name, found in results.items():
        lines += [
            f"| `{name}` | {setting} | {row['reached']:.0f} of {row['targets']:.0f} | {row['cost']:.2g} "
            f"| {row['turn']:.2f} | {row['travel']:.2f} |"
            for setting, row in found.items()
        ]
    return "\n".join(lines)


def main() -> None:
    """Measure, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", nargs="+", default=["satellite_ur5", "satellite_panda"])
    parser.add_argument("--targets", type=int, default=10, help="targets per robot (default: 10)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", default="results/trade-off.json", help="file for all numbers")
    parser.add_argument("--figure", default="results/trade-off.png", help="file for the figure")
    parser.add_argument("--draw", action="store_true", help="draw the numbers of an earlier run")
    arguments = parser.parse_args()
    path = Path(arguments.out)
    if arguments.draw:
        results = json.loads(path.read_text("utf-8"))
    else:
        results = {name: measure(name, arguments.targets, arguments.seed) for name in arguments.arms}
        path.parent.mkdir(parents=True, exist_ok=True)
        write_content(path, json.dumps(results, indent=1))
    print(table(results))
    draw(results, Path(arguments.figure))


if __name__ == "__main__":
    main()
