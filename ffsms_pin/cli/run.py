"""`ffsms-pin run`: plan, track, print the summary, write the results."""

from __future__ import annotations

import argparse
import json
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from ffsms_pin.cli.output import NO_FIGURES, desktop, output_console, say
from ffsms_pin.cli.progress import shown_progress
from ffsms_pin.cli.results_folder import chosen_folder, results_folder
from ffsms_pin.cli.summary_table import summary_table
from ffsms_pin.errors import InvalidValue
from ffsms_pin.extras import installed
from ffsms_pin.scenarios import Outcome, Scenario, scenario, summary
from ffsms_pin.scenarios import run as run_scenario
from ffsms_pin.scenarios.definition import save_scenario
from ffsms_pin.scenarios.run import StageProgress, writes_files
from ffsms_pin.storage import write_content
from ffsms_pin.studies.client_motion import client_motion

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Run the scenario and write its results; the exit code says whether plan and closed loop arrive."""
    if arguments.replay is None:
        chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    else:
        campaign, seed = arguments.replay
        chosen = _replayed(campaign, seed, arguments.allow_import)
    folder = chosen_folder(arguments.out, chosen.name)
    errors = Console(stderr=True)
    failure: BaseException | None = None
    with results_folder(folder, at_once=writes_files(chosen)) as staging, shown_progress(errors) as progress:
        outcome = run_scenario(chosen, progress, folder=folder, allow_outside=arguments.allow_outside)
        _save(outcome, staging)
        try:
            numbers = _derive(outcome, staging, arguments.figures, progress)
        except BaseException as error:  # also Ctrl-C: what was computed is kept
            failure = error
    if failure is not None:
        errors.print(f"plan and recording are kept in {folder}", markup=False, highlight=False)
        raise failure
    output_console().print(summary_table(numbers))
    say(f"results: {folder}")
    if arguments.figures and not installed("plot"):
        errors.print(NO_FIGURES, markup=False)
    if arguments.show:
        _show(folder, arguments.figures and installed("plot"))
    arrived = outcome.trajectory.reached and numbers["tracking"]["arrived"]
    return 0 if arrived else 1


def _save(outcome: Outcome, staging: Path) -> None:
    """Write what was computed."""
    outcome.trajectory.save(staging / "trajectory.npz")
    outcome.tracking.save(staging / "tracking.npz")
    if outcome.capture is not None:
        outcome.capture.tracking.save(staging / "capture.npz")
        client_motion(outcome.plant, outcome.tracking, outcome.capture).save(staging / "client.npz")
    save_scenario(outcome.scenario, staging / "scenario.json")


def _derive(outcome: Outcome, staging: Path, figures: bool, progress: StageProgress) -> dict[str, Any]:
    """Write what follows from it, numbers first; returns these."""
    numbers = summary(outcome)
    text = json.dumps(numbers, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_content(staging / "summary.json", text)
    if figures and outcome.capture is not None and installed("view"):
        from ffsms_pin.viewer import view_capture

        view_capture(outcome, title=outcome.scenario.name).to_html(staging / "capture.html")
    if figures and installed("plot"):
        from ffsms_pin.plotting import save_figures

        save_figures(outcome, staging, progress=lambda share: progress("figures", share))
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
        shown = folder / "motion.png"
    else:
        say("nothing to show: it needs meshcat (pip install 'ffsms-pin[view]')")
        return
    if not (desktop() and webbrowser.open(shown.resolve().as_uri())):
        say(f"to look at: {shown}")
