"""Format results as Markdown tables, one or more for each section."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def us(seconds: float) -> str:
    """Return a time [s] as text in microseconds."""
    return f"{1e6 * seconds:.1f}"


def spread(times: dict[str, float], unit: float = 1e6, digits: int = 1) -> str:
    """Return the median and, in brackets, the 10th and 90th percentiles."""
    return (
        f"{unit * times['median']:.{digits}f} "
        f"({unit * times['p10']:.{digits}f} to {unit * times['p90']:.{digits}f})"
    )


def machine(facts: dict[str, Any]) -> str:
    """Return a text of the machine and the packages."""
    packages = ", ".join(f"{name} {version}" for name, version in facts["packages"].items())
    threads = ", ".join(f"{name}={value}" for name, value in facts["threads"].items())
    return (
        f"{facts['processor']}, {facts['cores']} cores, {facts['system']}, Python {facts['python']}; "
        f"load before the run {facts['load']}; {threads}.\n\n{packages}."
    )


def startup(found: dict[str, Any]) -> str:
    """Return the table of start-up times."""
    rows = [
        (name, spread(found["times"][name], 1e3, 0), f"{found['ratios'][name]:.2f}")
        for name in found["times"]
    ]
    return markdown(("process", "time [ms], median (10 to 90 %)", "relative to pinocchio and numpy"), rows)


def state(found: dict[str, Any]) -> str:
    """Return the table of states and control steps relative to their floors."""
    rows = [
        (
            row["what"],
            row["robot"],
            f"{row['least_us']:.1f}",
            f"{row['floor_us']:.1f}",
            f"{row['ratio']:.2f}",
            ", ".join(f"{name} {value:.1f}" for name, value in row["parts"].items()),
        )
        for rows in found.values()
        for row in rows
    ]
    return markdown(("what", "robot", "least time [us]", "floor [us]", "ratio", "the floor's calls"), rows)


def peers(found: list[dict[str, Any]]) -> str:
    """Return the table that compares other libraries."""
    rows = []
    for row in found:
        who = f"{row['peer']} {row.get('version', '')}".strip()
        if "reason" in row:
            rows.append((who, row["robot"], "", "not measured", "", row["reason"], ""))
            continue
        rows.append(
            (
                who,
                row["robot"],
                row["what"],
                spread(row["ours"]),
                spread(row["theirs"]),
                f"{row['ratio']:.2f}",
                f"{row['agreement']:.0e}",
            )
        )
    head = ("peer", "robot", "work", "ours [us]", "theirs [us]", "theirs / ours", "largest difference")
    return markdown(head, rows)


def sizes(found: dict[str, Any]) -> str:
    """Return the tables of times over numbers of joints and over durations."""
    what = ("state", "planning step", "control step")
    rows = [
        (row["robot"], str(row["joints"]), *(spread(row[name]) for name in what))
        for row in [*found["joints"], found["two_arms"]]
    ]
    for key, label in (("fitted", "exponent, all sizes"), ("last", "exponent, 14 to 30 joints")):
        rows.append((label, "", *(f"{found['exponents'][name][key]:.2f}" for name in what)))
    first = markdown(("robot", "joints", *(f"{name} [us]" for name in what)), rows)
    plans = [
        (
            row["robot"],
            str(row["joints"]),
            f"{1e3 * row['seconds']['median']:.0f}",
            f"{1e3 * row['seconds']['most']:.0f}",
            f"{row['reached']} of {row['plans']}",
        )
        for row in found["plans"]
    ]
    second = markdown(("robot", "joints", "opt.plan, median [ms]", "longest [ms]", "reached"), plans)
    runs = [
        (
            f"{row['duration']:g}",
            us(row["seconds"] / row["steps"]),
            f"{row['memory_MB']:.1f}",
            f"{row['bytes_a_step']:.0f}",
            f"{row['momentum']:.0e}",
        )
        for row in found["durations"]
    ]
    third = markdown(
        (
            "simulated [s]",
            "time per step [us]",
            "memory [MB]",
            "bytes per step",
            "largest momentum",
        ),
        runs,
    )
    return "\n\n".join([first, second, third])


def many(found: dict[str, Any]) -> str:
    """Return the tables of plans in several processes."""
    e = found["efficiency"]
    first = markdown(
        (
            "plans",
            "processes",
            "one by one [s]",
            "first / second call [s]",
            "efficiency, first / second call",
        ),
        [
            (
                str(e["plans"]),
                str(e["jobs"]),
                f"{e['one_by_one']:.1f}",
                f"{e['first']:.1f} / {e['second']:.1f}",
                f"{e['efficiency_first']:.2f} / {e['efficiency_second']:.2f}",
            )
        ],
    )
    rows = [(f"{row['plans']}", f"{row['seconds']:.2f}", f"{1e3 * row['each']:.1f}") for row in found["tiny"]]
    return "\n\n".join([first, markdown(("small plans", "time [s]", "each [ms]"), rows)])
