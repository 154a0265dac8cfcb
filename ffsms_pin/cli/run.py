"""The command `ffsms-pin run`: planning, tracking, the summary table and the results."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ffsms_pin.browser import open_in_browser
from ffsms_pin.cli import output
from ffsms_pin.cli.output import filled, limit_text, new_table, range_text, say
from ffsms_pin.errors import InvalidValue, installed, length_text
from ffsms_pin.scenarios import Outcome, Scenario, closed_loop, scenario, summary
from ffsms_pin.scenarios.closed_loop import StageProgress
from ffsms_pin.scenarios.definition import save_scenario

_UNITS = {"deg_per_s": "deg/s", "Nms": "N m s"}


def run(arguments: argparse.Namespace) -> int:
    """Run the scenario and write its results; return 0 or 1.

    The result is 0 if plan and closed loop arrive, or if a client is caught within all limits.
    """
    if arguments.replay is None:
        chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    else:
        campaign, seed = arguments.replay
        chosen = _replayed(campaign, seed, arguments.allow_import)
    folder = output.chosen_folder(arguments.out, chosen.name)
    errors, figures = Console(stderr=True), not arguments.no_figures
    failure: BaseException | None = None
    with output.results_folder(folder) as staging, output.shown_progress(errors) as progress:
        outcome = closed_loop.run(chosen, progress, folder=folder, allow_outside=arguments.allow_outside)
        _save(outcome, staging)
        try:
            numbers = _derive(outcome, staging, figures, progress)
        except BaseException as error:  # also Ctrl-C: keep the computed results
            failure = error
    if failure is not None:
        errors.print(f"plan and recording are kept in {folder}", markup=False, highlight=False)
        raise failure
    output.printed(folder, summary_table(numbers))
    if figures and not installed("plot"):
        errors.print(output.NO_FIGURES, markup=False)
    if arguments.show:
        _show(folder, figures and installed("plot"))
    failed = missed(numbers)
    output.output_console().print(_last_line(folder, failed), soft_wrap=True, highlight=False)
    return 1 if failed else 0


def missed(numbers: Mapping[str, Any]) -> str:
    """Return in one line why a run failed; empty if plan and closed loop arrive.

    For a capture only the flight is checked, because re-planning may succeed after a plan that misses.
    """
    tracking = numbers["tracking"]
    if not ("capture" in numbers or numbers["reached"]):
        return f"the plan does not reach its target: {numbers['note']}"
    if tracking["arrived"]:
        return ""
    note = str(tracking["note"]).removeprefix("not arrived: ")
    return note or tracking["planning_note"] or numbers["note"] or "no reason is known"


def _last_line(folder: Path, failed: str) -> str:
    """Return the last line of a run: the failure, in red, or the command that shows the motion."""
    if failed:
        return f"[red]not arrived: {escape(failed)}[/]"
    command = f"ffsms-pin view {shlex.quote(str(folder))}" if installed("view") else ""
    return "[green]arrived[/]" + (f"; to see the motion: {escape(command)}" if command else "")


def _save(outcome: Outcome, staging: Path) -> None:
    """Write plan, recordings and scenario."""
    outcome.trajectory.save(staging / "trajectory.npz")
    outcome.tracking.save(staging / "tracking.npz")
    if outcome.capture is not None:
        outcome.capture.whole.save(staging / "capture.npz")
    save_scenario(outcome.scenario, staging / "scenario.json")


def _derive(outcome: Outcome, staging: Path, figures: bool, progress: StageProgress) -> dict[str, Any]:
    """Write the summary, the scene of a capture and the figures; return the numbers of the summary."""
    numbers = summary(outcome)
    output.write_numbers(staging / "summary.json", numbers)
    if figures and outcome.capture is not None and installed("view"):
        from ffsms_pin.viewer import view_capture

        view_capture(outcome, title=outcome.scenario.name).to_html(staging / "capture.html")
    if figures and installed("plot"):
        from ffsms_pin.plotting import save_figures

        save_figures(outcome, staging, progress=partial(progress, "figures"))
    return numbers


def _replayed(folder: str, seed: str, allow_import: bool) -> Scenario:
    """Return the scenario of one run of a campaign, named after its seed."""
    from ffsms_pin.campaigns import Campaign

    if not seed.isdecimal():
        raise InvalidValue("SEED", seed, "must be a whole number of at least 0")
    campaign = Campaign.open(folder, allow_import=allow_import)
    if int(seed) not in campaign.seeds:
        first, last = campaign.seeds[0], campaign.seeds[-1]
        raise InvalidValue("SEED", seed, f"must be a seed of the campaign, {first} to {last}")
    chosen = campaign.scenario(int(seed))
    return replace(chosen, name=f"{chosen.name}-{int(seed)}")


def _show(folder: Path, drawn: bool) -> None:
    """Open the animated scene, or the figure if the viewer is missing; without a display, print the path."""
    if installed("view"):
        from ffsms_pin.cli.view import scene_of

        shown = folder / "view.html"
        scene_of(folder).to_html(shown)
    elif drawn:
        shown = next(file for name in ("capture", "motion") if (file := folder / f"{name}.png").is_file())
    else:
        say("nothing to show: --show needs meshcat (pip install 'ffsms-pin[view]')")
        return
    if not open_in_browser(shown):
        say(f"to see the motion, open {shown}")


def summary_table(numbers: Mapping[str, Any]) -> Table:
    """Return a table of the numbers of `ffsms_pin.scenarios.summary`."""
    title = f"{numbers['scenario']}: {numbers['robot']}, planned by the method '{numbers['method']}'"
    if "capture" in numbers:  # a shorter table, the capture first
        table, capture = new_table(title, "quantity", "value", "details"), numbers["capture"]
        client = _learnt("client", capture["client"]) if "client" in capture else ()
        return filled(table, _course(capture), _contact(capture), _after(capture), client, _flown(numbers))
    table = new_table(title, "quantity", "value", "limit")
    # The conditions of the closed loop that the scenario sets.
    conditions = [(escape(name), escape(text)) for name, text in numbers["conditions"].items()]
    joints = (_joint(joint) for joint in numbers["joints"])
    bodies = (_learnt(*body) for body in numbers.get("learnt", {"bodies": {}})["bodies"].items())
    sections = _plan(numbers), conditions, *joints, _tracking(numbers), *bodies, _timing(numbers["timing"])
    return filled(table, _both(numbers), *sections)


def _both(numbers: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield rows with errors of the re-planned motion and of the first plan, if both were simulated."""
    tracking, reach = numbers["tracking"], length_text(numbers["reach_m"])
    if (once := tracking["open_loop"]) is not None:
        key = _error_key(numbers)
        label = _ERRORS[key]
        yield f"{label}, re-planned", _stopped(tracking) or _error(tracking, key), reach
        yield f"{label}, planned once", _stopped(once) or _error(once, key), reach


_ERRORS = {"final_error_m": "final error", "path_error_max_m": "largest error on the path"}


def _error_key(numbers: Mapping[str, Any]) -> str:
    """Return the key of the error that determines whether a run arrives: on the path, or at the end."""
    return "path_error_max_m" if "path_error_max_m" in numbers else "final_error_m"


def _plan(numbers: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    yield "plan: reached", "[green]yes[/]" if numbers["reached"] else "[red]no[/]"
    yield "within the goal's tolerance", "yes" if numbers["within_tolerance"] else "[yellow]no[/]"
    if numbers["note"]:
        yield "  note", escape(numbers["note"])
    reach, clearance, base = length_text(numbers["reach_m"]), numbers["clearance"], numbers["base"]
    if "path_error_max_m" in numbers:
        allowed = length_text(numbers["path_tolerance_m"])
        yield "largest error on the path", length_text(numbers["path_error_max_m"]), allowed
        if angle := numbers["path_angle_error_max_deg"]:
            allowed = f"{numbers['path_orientation_tolerance_deg']:.3g} deg"
            yield "  largest attitude error", f"{angle:.3g} deg", allowed
    else:
        yield "final error", length_text(numbers["final_error_m"]), reach
        yield "error over the last 10 %", length_text(numbers["error_over_last_10_percent_m"]), reach
    yield "cost integral", f"{numbers['cost_integral_s']:.3g} s"
    yield from _clearance("least clearance", clearance)
    moved = [length_text(base[f"translation_{when}_m"]) for when in ("max", "final")]
    yield "base translation, max / final", " / ".join(moved)
    turned = f"{base['rotation_max_deg']:.2f} / {base['rotation_final_deg']:.2f} deg"
    yield "base rotation, max / final", turned


def _joint(joint: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    unit = "deg" if "position_min_deg" in joint else "m"
    moment, effort = ("Nm", "N m") if "torque_limit_Nm" in joint else ("N", "N")
    yield (
        escape(f"{joint['name']}: position"),
        f"{joint[f'position_min_{unit}']:.4g} to {joint[f'position_max_{unit}']:.4g} {unit}",
        range_text(joint[f"position_lower_limit_{unit}"], joint[f"position_upper_limit_{unit}"], unit),
    )
    for label, name, of, written in (
        ("rate", "rate", f"{unit}_per_s", f"{unit}/s"),
        ("acceleration", "acceleration", f"{unit}_per_s2", f"{unit}/s²"),
        ("torque, tracking", "torque", moment, effort),
    ):
        most = joint[f"{'tracking_' * (name == 'torque')}{name}_max_{of}"]
        yield f"  largest {label}", f"{most:.4g} {written}", limit_text(joint[f"{name}_limit_{of}"], written)


def _tracking(numbers: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    tracking, reach = numbers["tracking"], length_text(numbers["reach_m"])
    for unit in ("rad", "m"):
        if f"joint_error_max_{unit}" in tracking:
            largest, final = tracking[f"joint_error_max_{unit}"], tracking[f"joint_error_final_{unit}"]
            yield "tracking: joint error, max / final", f"{largest:.3g} / {final:.3g} {unit}"
    slowest = f"{tracking['longest_time_constant_s']:.3g} s"
    yield "  longest time constant of the gains", slowest, f"motion: {numbers['duration_s']:g} s"
    yield "  deviation from the first plan, max", length_text(tracking["end_effector_deviation_max_m"])
    yield "  arrived", "[green]yes[/]" if tracking["arrived"] else "[red]no[/]"
    if tracking["stopped"]:
        yield "  stopped by a guard", f"[red]{escape(tracking['stopped'])}[/]"
    if "path_error_max_m" in tracking:
        yield "  largest error on the path", _error(tracking, "path_error_max_m"), reach
        if angle := tracking["path_angle_error_max_deg"]:
            yield "    largest attitude error", f"{angle:.3g} deg"
    else:
        yield "  final error to target", _error(tracking, "final_error_m"), reach
        if tracking["final_error_deg"]:
            yield "  final attitude error", f"{tracking['final_error_deg']:.3g} deg"
    for frame, errors in tracking["frames"].items():
        yield escape(f"  final error of '{frame}'"), _pose_error(errors)
    yield from _clearance("  least clearance", tracking["clearance"])
    for label, note in (("note", tracking["note"]), ("note of re-planning", tracking["planning_note"])):
        if note:
            yield f"  {label}", escape(note)
    if "wheels" in tracking or "propellant_kg" in tracking:  # actuator use
        base = tracking["base"]
        turned = f"{base['rotation_max_deg']:.3g} / {base['rotation_final_deg']:.3g} deg"
        yield "  base rotation, max / final", turned
    for wheel in tracking.get("wheels", ()):
        done = f"{wheel['momentum_max_Nms']:.3g} N m s, {wheel['torque_max_Nm']:.3g} N m"
        yield escape(f"  {wheel['name']}: largest momentum, torque"), done
    if "propellant_kg" in tracking:
        yield "  propellant", f"{1e3 * tracking['propellant_kg']:.3g} g"
    linear = f"{tracking['momentum_linear_max_kg_m_per_s']:.1e} kg m/s"
    angular = f"{tracking['momentum_angular_max_kg_m2_per_s']:.1e} kg m²/s"
    yield "  total momentum, max", f"{linear}, {angular}"
    yield "  energy balance error, relative", f"{tracking['energy_error_relative']:.1e}"


def _timing(timing: Mapping[str, float]) -> Iterator[tuple[str, ...]]:
    for name, step in (("planning", "per_step"), ("tracking", "per_control_step")):
        yield name, f"{timing[f'{name}_s']:.2f} s"
        yield f"  {step.replace('_', ' ')}", f"{timing[f'{name}_{step}_ms']:.3f} ms"


def _error(run: Mapping[str, Any], key: str) -> str:
    """Return an error of a run, in red if the run has not arrived."""
    text = length_text(run[key])
    return text if run["arrived"] else f"[red]{text}[/]"


def _stopped(run: Mapping[str, Any]) -> str:
    """Return in red why the run was stopped; empty for a complete run."""
    return f"[red]{escape(run['stopped'])}[/]" if run["stopped"] else ""


def _pose_error(errors: Mapping[str, float]) -> str:
    """Return a distance and, if it is not zero, an angle as text."""
    angle = f", {errors['final_error_deg']:.3g} deg" if errors["final_error_deg"] else ""
    return length_text(errors["final_error_m"]) + angle


def _clearance(label: str, clearance: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield the rows of a least clearance, in red below the required clearance; none if unchecked."""
    if clearance["least_m"] is None:
        return
    text = length_text(clearance["least_m"])
    kept = clearance["least_m"] >= clearance["required_m"] - 1e-5
    yield label, text if kept else f"[red]{text}[/]", f">= {length_text(clearance['required_m'])}"
    yield "    between", escape(clearance["pair"]), f"at {clearance['time_s']:.4g} s"


def _course(capture: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield a row of the outcome, and a row for each phase of a capture."""
    caught = "[green]caught[/]" if capture["caught"] else "[red]not caught[/]"
    yield "client", caught, f"at attempt {capture['attempts']}"
    for phase in capture["phases"]:
        yield f"  {phase['t_s']:.4g} s: {phase['name']}", escape(phase["reason"])


def _contact(capture: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield rows of errors, velocity and largest load at the contact, with the predicted load."""
    if "miss_m" in capture:
        yield "position error at contact", length_text(capture["miss_m"]), f"{capture['miss_deg']:.2g} deg"
        speed, spin = 1e3 * capture["contact_velocity_m_per_s"], capture["contact_velocity_deg_per_s"]
        yield "relative velocity at contact", f"{speed:.2g} mm/s", f"{spin:.2g} deg/s"
    if capture["contact_force_max_N"] is None:
        return
    load = f"{capture['contact_force_max_N']:.3g} N, {capture['contact_torque_max_Nm']:.3g} N m"
    yield "largest load of the grip", load, _of_limit(capture["contact_joint_torque_share"])
    for label, name in (("at the contact", "expected"), ("before the flight", "predicted")):
        if f"{name}_contact_force_N" in capture:
            force, torque = capture[f"{name}_contact_force_N"], capture[f"{name}_contact_torque_Nm"]
            most = f"bound {capture[f'{name}_contact_force_most_N']:.3g} N"
            within = "" if capture[f"{name}_contact_force_within"] else "[red], force exceeds it[/]"
            yield f"  predicted {label}", f"{force:.3g} N, {torque:.3g} N m", most + within


def _after(capture: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield rows of the braking, and of final base rates and wheel momenta with their predictions."""
    yield "joints braked in", f"{capture['braking_s']:.3g} s", _of_limit(capture["flown_torque_share"])
    if capture["braking_note"]:
        yield "  note", escape(capture["braking_note"])
    if capture["braking_nearest"]:
        clearance = length_text(capture["braking_clearance_m"])
        yield "  least clearance", clearance, escape(capture["braking_nearest"])
    for key, quantity, unit in (
        ("base_rate", "base rate", "deg_per_s"),
        ("wheel_momentum", "wheels' momenta", "Nms"),
    ):
        if f"predicted_{key}_{unit}" not in capture:
            continue
        labels = {"final": f"{quantity} at the end", "total": "  at rest"}
        labels |= {"expected": "  predicted at the contact", "predicted": "  predicted before the flight"}
        for name, label in labels.items():
            if f"{name}_{key}_{unit}" not in capture:
                continue
            values, within = capture[f"{name}_{key}_{unit}"], ""
            if f"{name}_within_3_deviations" in capture:
                within = f"+-{max(capture[f'{name}_deviation_{unit}']):.2g} {_UNITS[unit]}"
                within += "" if capture[f"{name}_within_3_deviations"] else "[red], beyond 3 sigma[/]"
            yield label, ", ".join(f"{value:.4f}" for value in values) + f" {_UNITS[unit]}", within


def _learnt(name: str, body: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield rows of a body's estimated mass and principal inertias, with prior and true values."""
    label, prior, learnt, true = escape(f"{name}: mass"), body["believed"], body["learnt"], body["true"]
    details = f"prior {prior['mass_kg']:.4g}, true {true['mass_kg']:.4g} kg"
    if learnt is None:
        yield label, "not identified", details
    else:
        yield label, f"{learnt['mass_kg']:.4g} +- {body['mass_deviation_kg']:.2g} kg", details
        details = f"prior {_principal(prior)}, true {_principal(true)}"
        yield "  principal inertias", f"{_principal(learnt)} kg m²", details
    if body.get("note"):
        yield "  note", escape(body["note"])


def _principal(body: Mapping[str, Any]) -> str:
    """Return the principal inertias of a body as text, "none" for a body without mass."""
    if body["inertia_kg_m2"] is None:
        return "none"
    return ", ".join(f"{value:.3g}" for value in np.linalg.eigvalsh(body["inertia_kg_m2"]))


def _flown(numbers: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield rows of the first plan, the flown motion and the errors of the simulation."""
    tracking, joints, timing = numbers["tracking"], numbers["joints"], numbers["timing"]
    reached = "arrives" if numbers["reached"] else "[red]does not arrive[/]"
    yield "first plan", f"{reached}, {length_text(numbers['final_error_m'])} off", escape(numbers["note"])
    if tracking["open_loop"] is not None:
        once = tracking["open_loop"]
        off = once["stopped"] or f"{length_text(once['final_error_m'])} off"
        yield "  flown without re-planning", escape(off), ""
    yield from _clearance("least clearance of the flight", tracking["clearance"])
    rates = [
        (joint, key) for joint in joints for key in joint if key.startswith("rate_limit_") and joint[key]
    ]
    shares = [(joint[of.replace("limit", "max")] / joint[of], joint["name"]) for joint, of in rates]
    if shares:
        most, name = max(shares)
        yield "largest rate planned", f"{100.0 * most:.3g} % of its limit", escape(name)
    yield "largest torque of the approach", _of_limit(tracking["torque_max_relative"])
    if (wrist := tracking.get("wrist")) is not None:
        force, moment = wrist["force_max_N"], wrist["moment_max_Nm"]
        share = max(force / (wrist["force_limit_N"] or inf), moment / (wrist["moment_limit_Nm"] or inf))
        yield "largest load of the wrist", f"{force:.3g} N, {moment:.3g} N m", _of_limit(share, "its limits")
    for label, note in (("note", tracking["note"]), ("note of re-planning", tracking["planning_note"])):
        if note:
            yield label, escape(note)
    change = f"{numbers['capture']['momentum_change_relative']:.1e}"
    energy = f"energy balance {tracking['energy_error_relative']:.1e}"
    yield "momentum change, relative", change, energy
    yield "computing time", f"{timing['planning_s']:.2f} s planning", f"{timing['tracking_s']:.2f} s flight"


def _of_limit(share: float, of: str = "the torque limit") -> str:
    """Return a share of a limit in percent, by default of the joints' torque limits; red above 100 %."""
    text = f"{100.0 * share:.3g} % of {of}"
    return f"[red]{text}[/]" if share > 1.0 else text
