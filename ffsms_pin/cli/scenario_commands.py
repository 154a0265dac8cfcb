"""Arguments and help of the commands on scenarios, in the order of --help."""

from __future__ import annotations

from argparse import ArgumentParser

from ffsms_pin.cli.main import PACKAGED_OR_FILE, add_scenario, command, flag, option


@command(
    "run:run",
    "0 the plan reaches the target and the closed loop ends there; 1 one of them does not, results "
    "written; 2 bad input, or the run was stopped",
)
def run(parser: ArgumentParser) -> None:
    """Plan and track a scenario, write results.

    Plan a scenario and follow it in closed loop, under whatever conditions it sets: a plant that is not the
    model, planning again in the loop, friction, sensors, disturbances, failures (all keys: page "Scenario
    files" of the documentation, docs/scenarios.md). Prints a summary table, and writes trajectory.npz,
    tracking.npz, scenario.json, summary.json and the figures (pdf and png).

    example: ffsms-pin run case-2 --out results/case-2
    One run of a campaign, by its seed: ffsms-pin run --replay results/mine-campaign 4711
    """
    what = parser.add_mutually_exclusive_group(required=True)
    words = "case-1, case-2, wrong-model, capture, nozzle, or a scenario file (TOML)"
    what.add_argument("scenario", metavar="SCENARIO", nargs="?", help=words)
    words = "one run of the campaign in a folder, by its seed"
    what.add_argument("--replay", metavar=("DIR", "SEED"), nargs=2, help=words)
    add_scenario(parser, "")
    flag(parser, "--no-figures", "write the numbers only, no figures")
    flag(parser, "--show", "open the animated scene, where there is a display")
    words = "let the file of [watchdog] path lie outside the results folder"
    flag(parser, "--allow-outside", words)


@command("scenario:run")
def scenario(parser: ArgumentParser) -> None:
    """A packaged scenario file as text, or the JSON Schema of scenario files.

    The file is to be changed and run; with the schema, editors complete keys and show units.

    For example:
      ffsms-pin scenario --print case-2 > mine.toml
      ffsms-pin scenario --schema > scenario.schema.json

    An editor that reads schemas of TOML (Even Better TOML, Taplo) takes it by a first line in the file:
      #:schema ./scenario.schema.json
    """
    what = parser.add_mutually_exclusive_group(required=True)
    words = "case-1, case-2, wrong-model, capture, nozzle"
    what.add_argument("--print", dest="name", metavar="NAME", help=words)
    flag(what, "--schema", "the JSON Schema")


@command("compare:run")
def compare(parser: ArgumentParser) -> None:
    """Plan a scenario by every method, side by side.

    Prints one table, and writes comparison.json and one figure.

    example: ffsms-pin compare case-2
    """
    add_scenario(parser, "-comparison", PACKAGED_OR_FILE)
    methods = "horizon, step, paper, resolved-rate, least-disturbance, minimum-effort"
    shown = "all that know what the scenario asks for"
    option(parser, "--methods", "METHOD", f"only these, of {methods}", shown=shown, nargs="+")


@command("campaign:campaign", "0 done, however many arrived; 2 bad input, or workers are gone", resumes=True)
def campaign(parser: ArgumentParser) -> None:
    """Run a scenario many times with drawn plants, targets, noise and faults.

    Each run is in closed loop, and drawn from the distributions in the scenario's table [campaign.draw]
    (docs/campaigns.md). Writes one row a run to DIR/runs.csv, a report (report.json) and figures. The same
    command goes on where it was killed, and ends with the same table, whatever the number of processes.

    For example:
      ffsms-pin campaign mine.toml --runs 10000 --out mine          one process a core
      ffsms-pin campaign mine.toml --runs 10000 --out mine --scheduler tcp://head:8786
      ffsms-pin campaign mine --runs 20000                          ten thousand more in the folder mine
      ffsms-pin campaign case-1 --runs 50 --compare                 planned once and re-planned, side by side
      ffsms-pin run --replay mine 4711                              one of its runs alone, by its seed
    """
    words = "a packaged scenario, a scenario file (TOML) with [campaign.draw], or the folder of a campaign"
    add_scenario(parser, "-campaign", words)
    option(parser, "--runs", "N", "how many; a folder has its own number", kind=int)
    option(parser, "--seed", "N", "of the first run", shown="the file's, or 1", kind=int)
    flag(parser, "--compare", "follow each drawn scenario planned once and re-planned")
    where = parser.add_mutually_exclusive_group()
    option(where, "--jobs", "N", "processes at once; 1 needs no Dask", shown="one a core", kind=int)
    option(where, "--scheduler", "ADDRESS", "a Dask scheduler that stands, as tcp://host:8786")
