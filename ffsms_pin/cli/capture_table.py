"""The table of a capture: what became of the client first, then what it cost, on one screen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf
from typing import Any

from rich.markup import escape
from rich.table import Table

from ffsms_pin.cli.output import filled, length_text, new_table

_UNITS = {"deg_per_s": "deg/s", "Nms": "N m s"}


def capture_table(numbers: Mapping[str, Any]) -> Table:
    """Of what `ffsms_pin.scenarios.summary` gives of a scenario with a client."""
    table = new_table(f"{numbers['scenario']}: {numbers['robot']}", "quantity", "value", "beside")
    capture = numbers["capture"]
    return filled(table, _course(capture), _contact(capture), _after(capture), _flown(numbers))


def _course(capture: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    caught = "[green]caught[/]" if capture["caught"] else "[red]not caught[/]"
    yield "client", caught, f"at attempt {capture['attempts']}"
    for phase in capture["phases"]:
        yield f"  {phase['t_s']:.4g} s: {phase['name']}", escape(phase["reason"])


def _contact(capture: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Where and how fast the gripper closed, and what it bore beside what was said."""
    if "miss_m" in capture:
        yield "grasp missed by", length_text(capture["miss_m"]), f"{capture['miss_deg']:.2g} deg"
        speed, spin = 1e3 * capture["contact_velocity_m_per_s"], capture["contact_velocity_deg_per_s"]
        yield "passed at", f"{speed:.2g} mm/s", f"{spin:.2g} deg/s"
    if capture["contact_force_max_N"] is None:
        return
    load = f"{capture['contact_force_max_N']:.3g} N, {capture['contact_torque_max_Nm']:.3g} N m"
    yield "largest load of the grip", load, _of_limit(capture["contact_joint_torque_share"])
    for label, name in (("at the contact", "expected"), ("before the flight", "predicted")):
        if f"{name}_contact_force_N" in capture:
            force, torque = capture[f"{name}_contact_force_N"], capture[f"{name}_contact_torque_Nm"]
            most = f"at most {capture[f'{name}_contact_force_most_N']:.3g} N"
            within = "" if capture[f"{name}_contact_force_within"] else "[red], exceeded[/]"
            yield f"  said {label}", f"{force:.3g} N, {torque:.3g} N m", most + within


def _after(capture: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Braking, and what the momentum dictates beside what was said of it."""
    yield "joints braked in", f"{capture['braking_s']:.3g} s", _of_limit(capture["flown_torque_share"])
    if capture["braking_note"]:
        yield "  note", escape(capture["braking_note"])
    if capture["braking_nearest"]:
        clearance = length_text(capture["braking_clearance_m"])
        yield "  least clearance", clearance, escape(capture["braking_nearest"])
    for what, words, unit in (("base_rate", "base turns", "deg_per_s"), ("wheel_momentum", "wheels", "Nms")):
        if f"predicted_{what}_{unit}" not in capture:
            continue
        labels = {"final": f"{words} in the end", "total": "  at rest they will have"}
        labels |= {"expected": "  said at the contact", "predicted": "  said before the flight"}
        for name, label in labels.items():
            if f"{name}_{what}_{unit}" not in capture:
                continue
            values, within = capture[f"{name}_{what}_{unit}"], ""
            if f"{name}_within_3_deviations" in capture:
                within = f"+-{max(capture[f'{name}_deviation_{unit}']):.2g} {_UNITS[unit]}"
                within += "" if capture[f"{name}_within_3_deviations"] else "[red], exceeded threefold[/]"
            yield label, ", ".join(f"{value:.4f}" for value in values) + f" {_UNITS[unit]}", within


def _flown(numbers: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """The first plan, how it was flown, and what the simulation is worth."""
    tracking, joints, timing = numbers["tracking"], numbers["joints"], numbers["timing"]
    reached = "arrives" if numbers["reached"] else "[red]does not arrive[/]"
    yield "first plan", f"{reached}, {length_text(numbers['final_error_m'])} off", escape(numbers["note"])
    if tracking["open_loop"] is not None:
        once = tracking["open_loop"]
        off = once["stopped"] or f"{length_text(once['final_error_m'])} off"
        yield "  flown as it was", escape(off), ""
    if tracking["least_clearance_m"] is not None:
        wanted = f">= {length_text(numbers['clearance']['wanted_m'])}"
        yield "least clearance on the way", length_text(tracking["least_clearance_m"]), wanted
    rates = [
        (joint, key) for joint in joints for key in joint if key.startswith("rate_limit_") and joint[key]
    ]
    shares = [(joint[of.replace("limit", "max")] / joint[of], joint["name"]) for joint, of in rates]
    if shares:
        most, name = max(shares)
        yield "largest rate planned", f"{100.0 * most:.3g} % of its limit", escape(name)
    yield "largest torque on the way", _of_limit(tracking["torque_max_relative"])
    if (wrist := tracking.get("wrist")) is not None:
        force, moment = wrist["force_max_N"], wrist["moment_max_Nm"]
        share = max(force / (wrist["force_limit_N"] or inf), moment / (wrist["moment_limit_Nm"] or inf))
        yield "largest load of the wrist", f"{force:.3g} N, {moment:.3g} N m", _of_limit(share, "its limits")
    for label, note in (("note", tracking["note"]), ("re-planning says", tracking["planning_note"])):
        if note:
            yield label, escape(note)
    lost = f"{numbers['capture']['momentum_change_relative']:.1e}"
    energy = f"energy {tracking['energy_error_relative']:.1e}"
    yield "momentum changed by, relative", lost, energy
    yield "computed in", f"{timing['planning_s']:.2f} s planning", f"{timing['tracking_s']:.2f} s flight"


def _of_limit(share: float, of: str = "the torques") -> str:
    """A share of limits, by default the joints' torques: in red where it is more than there is."""
    text = f"{100.0 * share:.3g} % of {of}"
    return f"[red]{text}[/]" if share > 1.0 else text
