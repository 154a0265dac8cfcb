"""`ffsms-pin run`: plan, track, print the summary as a table, write the results."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ffsms_pin import scenarios
from ffsms_pin.cli.capture_table import capture_table
from ffsms_pin.cli.output import (
    NO_FIGURES,
    filled,
    length_text,
    limit_text,
    new_table,
    opened,
    printed,
    range_text,
    say,
    shown_progress,
)
from ffsms_pin.cli.results_folder import chosen_folder, results_folder, write_numbers
from ffsms_pin.errors import InvalidValue
from ffsms_pin.extras import installed
from ffsms_pin.scenarios import Outcome, Scenario, scenario, summary
from ffsms_pin.scenarios.definition import save_scenario
from ffsms_pin.scenarios.run import StageProgress, writes_files


def run(arguments: argparse.Namespace) -> int:
    """Run the scenario and write its results; the exit code says whether plan and closed loop arrive."""
    if arguments.replay is None:
        chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    else:
        campaign, seed = arguments.replay
        chosen = _replayed(campaign, seed, arguments.allow_import)
    folder = chosen_folder(arguments.out, chosen.name)
    errors, figures = Console(stderr=True), not arguments.no_figures
    failure: BaseException | None = None
    with results_folder(folder, at_once=writes_files(chosen)) as staging, shown_progress(errors) as progress:
        outcome = scenarios.run(chosen, progress, folder=folder, allow_outside=arguments.allow_outside)
        _save(outcome, staging)
        try:
            numbers = _derive(outcome, staging, figures, progress)
        except BaseException as error:  # also Ctrl-C: what was computed is kept
            failure = error
    if failure is not None:
        errors.print(f"plan and recording are kept in {folder}", markup=False, highlight=False)
        raise failure
    printed(folder, summary_table(numbers))
    if figures and not installed("plot"):
        errors.print(NO_FIGURES, markup=False)
    if arguments.show:
        _show(folder, figures and installed("plot"))
    if "capture" in numbers:  # by whichever attempt
        return 0 if numbers["capture"]["caught"] else 1
    return 0 if outcome.trajectory.reached and numbers["tracking"]["arrived"] else 1


def _save(outcome: Outcome, staging: Path) -> None:
    """Write what was computed."""
    outcome.trajectory.save(staging / "trajectory.npz")
    outcome.tracking.save(staging / "tracking.npz")
    if outcome.capture is not None:
        outcome.capture.whole.save(staging / "capture.npz")
    save_scenario(outcome.scenario, staging / "scenario.json")


def _derive(outcome: Outcome, staging: Path, figures: bool, progress: StageProgress) -> dict[str, Any]:
    """Write what follows from it, numbers first; returns these."""
    numbers = summary(outcome)
    write_numbers(staging / "summary.json", numbers)
    if figures and outcome.capture is not None and installed("view"):
        from ffsms_pin.viewer import view_capture

        view_capture(outcome, title=outcome.scenario.name).to_html(staging / "capture.html")
    if figures and installed("plot"):
        from ffsms_pin.plotting import save_figures

        save_figures(outcome, staging, progress=partial(progress, "figures"))
    return numbers


def _replayed(folder: str, seed: str, allow_import: bool) -> Scenario:
    """The scenario of one run of a campaign, named after its seed."""
    from ffsms_pin.campaigns import replayed_scenario

    if not seed.isdecimal():
        raise InvalidValue("SEED", seed, "must be a whole number of at least 0")
    chosen = replayed_scenario(folder, int(seed), allow_import=allow_import)
    return replace(chosen, name=f"{chosen.name}-{int(seed)}")


def _show(folder: Path, drawn: bool) -> None:
    """Open the scene of the results, or the drawing without the viewer; say where it is without a desktop."""
    if installed("view"):
        from ffsms_pin.cli.view import scene_of

        shown = folder / "view.html"
        scene_of(folder).to_html(shown)
    elif drawn:
        shown = next(one for name in ("capture", "motion") if (one := folder / f"{name}.png").is_file())
    else:
        say("nothing to show: it needs meshcat (pip install 'ffsms-pin[view]')")
        return
    if not opened(shown):
        say(f"to look at: {shown}")


def summary_table(numbers: Mapping[str, Any]) -> Table:
    """Table of what `ffsms_pin.scenarios.summary` gives."""
    if "capture" in numbers:
        return capture_table(numbers)
    table = new_table(f"{numbers['scenario']}: {numbers['robot']}", "quantity", "value", "limit")
    # What the scenario says about its closed loop.
    conditions = [(escape(name), escape(words)) for name, words in numbers["conditions"].items()]
    joints = (_joint(joint) for joint in numbers["joints"])
    return filled(table, _plan(numbers), conditions, *joints, _tracking(numbers), _timing(numbers["timing"]))


def _plan(numbers: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    yield "reached", "[green]yes[/]" if numbers["reached"] else "[red]no[/]"
    yield "within tolerance", "yes" if numbers["within_tolerance"] else "[yellow]no[/]"
    if numbers["note"]:
        yield "  note", escape(numbers["note"])
    reach, clearance, base = length_text(numbers["reach_m"]), numbers["clearance"], numbers["base"]
    yield "final error", length_text(numbers["final_error_m"]), reach
    yield "error over the last 10 %", length_text(numbers["error_over_last_10_percent_m"]), reach
    yield "cost integral", f"{numbers['cost_integral_s']:.3g} s"
    if clearance["least_m"] is not None:
        yield "least clearance", length_text(clearance["least_m"]), f">= {length_text(clearance['wanted_m'])}"
    moved = [length_text(base[f"translation_{when}_m"]) for when in ("max", "final")]
    yield "base translation, max / final", " / ".join(moved)
    turned = f"{base['rotation_max_deg']:.2f} / {base['rotation_final_deg']:.2f} deg"
    yield "base rotation, max / final", turned


def _joint(joint: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    unit = "deg" if "position_min_deg" in joint else "m"
    moment = "Nm" if "torque_limit_Nm" in joint else "N"
    yield (
        escape(f"{joint['name']}: position"),
        f"{joint[f'position_min_{unit}']:.4g} to {joint[f'position_max_{unit}']:.4g} {unit}",
        range_text(joint[f"position_lower_limit_{unit}"], joint[f"position_upper_limit_{unit}"], unit),
    )
    for label, name, of, written in (
        ("rate", "rate", f"{unit}_per_s", f"{unit}/s"),
        ("acceleration", "acceleration", f"{unit}_per_s2", f"{unit}/s²"),
        ("torque, tracking", "torque", moment, moment),
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
    yield "  longest time constant of the gains", slowest, f"{numbers['duration_s']:g} s"
    yield "  end effector from plan, largest", length_text(tracking["end_effector_deviation_max_m"])
    yield "  final error to target", _final_error(tracking), reach
    if tracking["open_loop"] is not None:
        yield "  the same, plan made once", _final_error(tracking["open_loop"]), reach
    if tracking["least_clearance_m"] is not None:
        wanted = f">= {length_text(numbers['clearance']['wanted_m'])}"
        yield "  least clearance", length_text(tracking["least_clearance_m"]), wanted
    for label, note in (("note", tracking["note"]), ("re-planning says", tracking["planning_note"])):
        if note:
            yield f"  {label}", escape(note)
    if "wheels" in tracking or "propellant_kg" in tracking:  # what they did
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
    yield "  total momentum, largest", f"{linear}, {angular}"
    yield "  energy less work, relative", f"{tracking['energy_error_relative']:.1e}"


def _timing(timing: Mapping[str, float]) -> Iterator[tuple[str, ...]]:
    for name, step in (("planning", "per_step"), ("tracking", "per_control_step")):
        yield name, f"{timing[f'{name}_s']:.2f} s"
        yield f"  {step.replace('_', ' ')}", f"{timing[f'{name}_{step}_ms']:.3f} ms"


def _final_error(run: Mapping[str, Any]) -> str:
    """Where a run ended: in red where that is too far away."""
    if run.get("stopped"):
        return f"[red]{escape(run['stopped'])}[/]"
    text = length_text(run["final_error_m"])
    return text if run["arrived"] else f"[red]{text}[/]"
