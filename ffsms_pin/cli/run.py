"""`ffsms-pin run`: plan, track, print the summary, write the results."""

from __future__ import annotations

import json
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from ffsms_pin.cli.output import output_console
from ffsms_pin.cli.progress import shown_progress
from ffsms_pin.cli.results_folder import chosen_folder, results_folder
from ffsms_pin.cli.summary_table import summary_table
from ffsms_pin.cli.view_command import desktop
from ffsms_pin.errors import InvalidValue
from ffsms_pin.extras import installed
from ffsms_pin.scenarios import Outcome, Scenario, run, scenario, summary
from ffsms_pin.scenarios.client_motion import client_motion
from ffsms_pin.scenarios.definition import save_scenario
from ffsms_pin.scenarios.run import StageProgress, writes_files
from ffsms_pin.storage import write_content

__all__ = ["replayed", "run_scenario"]


def run_scenario(
    name: str | Scenario,
    out: str | None = None,
    figures: bool = True,
    show: bool = False,
    allow_outside: bool = False,
    allow_import: bool = False,
) -> bool:
    """Run a scenario and write its results.

    Parameters
    ----------
    name : str or Scenario
        A packaged scenario, a file, or what was read from one.
    out : str, optional
        Folder for the results; default results/<name of the scenario>.
    figures : bool
        Whether figures are drawn.
    show : bool
        Whether to open the animated scene, where there is a display; without the viewer the drawing.
    allow_outside : bool
        Whether files that the scenario names may lie elsewhere than below the results folder.
    allow_import : bool
        Whether terms and limits of the scenario may be imported from Python modules, which runs their code.

    Returns
    -------
    bool
        Whether the plan reaches its target, and the closed loop ends there.
    """
    chosen = scenario(name, allow_import=allow_import) if isinstance(name, str) else name
    folder = chosen_folder(out, chosen.name)
    errors, output = Console(stderr=True), output_console()
    at_once = writes_files(chosen)
    failure: BaseException | None = None
    with results_folder(folder, at_once) as staging, shown_progress(errors) as progress:
        outcome = run(chosen, progress, folder=folder, allow_outside=allow_outside)
        _save(outcome, staging)
        try:
            numbers = _derive(outcome, staging, figures, progress)
        except BaseException as error:  # also Ctrl-C: what was computed is kept
            failure = error
    if failure is not None:
        errors.print(f"plan and recording are kept in {folder}", markup=False, highlight=False)
        raise failure
    output.print(summary_table(numbers))
    output.print(f"results: {folder}", markup=False, highlight=False, soft_wrap=True)
    if figures and not installed("plot"):
        errors.print("no figures: they need matplotlib (pip install 'ffsms-pin[plot]')", markup=False)
    if show:
        _show(folder, figures and installed("plot"), output)
    return outcome.trajectory.reached and bool(numbers["tracking"]["arrived"])


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


def replayed(folder: str, seed: str, allow_import: bool = False) -> Scenario:
    """The scenario of one run of a campaign, named after its seed."""
    from ffsms_pin.campaigns import replayed_scenario

    if not seed.isdecimal():
        raise InvalidValue("SEED", seed, "must be a whole number of at least 0")
    chosen = replayed_scenario(folder, int(seed), allow_import=allow_import)
    return replace(chosen, name=f"{chosen.name}-{int(seed)}")


def _show(folder: Path, drawn: bool, output: Console) -> None:
    """Open the scene of the results in the browser, or the drawing of the motion without the viewer.

    Without a desktop, say where it is.
    """
    if installed("view"):
        from ffsms_pin.cli.viewed import scene_of

        shown = folder / "view.html"
        scene_of(folder).to_html(shown)
    elif drawn:
        shown = folder / "motion.png"
    else:
        output.print("nothing to show: it needs meshcat (pip install 'ffsms-pin[view]')", markup=False)
        return
    if not (desktop() and webbrowser.open(shown.resolve().as_uri())):
        output.print(f"to look at: {shown}", markup=False, highlight=False, soft_wrap=True)
