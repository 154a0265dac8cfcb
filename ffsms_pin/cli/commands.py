"""What the commands say and take, in the order of --help."""

from __future__ import annotations

from argparse import ArgumentParser

from ffsms_pin.cli.arguments import (
    PACKAGED_OR_FILE,
    add_jobs,
    add_robot,
    add_scenario,
    add_work,
    command,
    flag,
    option,
)


@command("docs:quickstart")
def quickstart(parser: ArgumentParser) -> None:
    """Write a notebook to begin with.

    It has a first robot, plan, simulation and film, and goes into the current folder.

    example: ffsms-pin quickstart --notebook
    """
    flag(parser, "--notebook", "open it in Jupyter Lab, and stay until that ends")
    option(parser, "--out", "FILE", "the file to write, which must not be there", "quickstart.ipynb")


@command(
    "run:run",
    "0 plan and closed loop arrive; 1 one does not, results written; 2 bad input, or stopped",
)
def run(parser: ArgumentParser) -> None:
    """Plan and track a scenario, write results.

    Plan a scenario and follow it in closed loop, under whatever conditions it sets: a plant that is not the
    model, planning again in the loop, friction, sensors, disturbances, failures (ffsms-pin docs scenarios
    lists all keys). Prints a summary table, and writes trajectory.npz, tracking.npz, scenario.json,
    summary.json and the figures (pdf and png).

    example: ffsms-pin run case-2 --out results/case-2
    One run of a campaign, by its seed: ffsms-pin run --replay results/mine-campaign 4711
    """
    what = parser.add_mutually_exclusive_group(required=True)
    words = "case-1, case-2, wrong-model, capture, or a scenario file (TOML)"
    what.add_argument("scenario", metavar="SCENARIO", nargs="?", help=words)
    words = "one run of the campaign in a folder, by its seed"
    what.add_argument("--replay", metavar=("DIR", "SEED"), nargs=2, help=words)
    add_scenario(parser, "")
    flag(parser, "--no-figures", "write the numbers only, no figures")
    flag(parser, "--show", "open the animated scene, where there is a display")
    words = "let files that the scenario names (stream, watchdog path) lie outside the results folder"
    flag(parser, "--allow-outside", words)


@command("docs:scenario_file")
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
    what.add_argument("--print", dest="name", metavar="NAME", help="case-1, case-2, wrong-model, capture")
    flag(what, "--schema", "the JSON Schema")


@command("comparisons:methods")
def compare(parser: ArgumentParser) -> None:
    """Plan a scenario by every method, side by side.

    Prints one table, and writes comparison.json and one figure.

    example: ffsms-pin compare case-2
    """
    add_scenario(parser, "-comparison", PACKAGED_OR_FILE)
    methods = "horizon, step, paper, resolved-rate, least-disturbance, minimum-effort"
    shown = "all that know what the scenario asks for"
    option(parser, "--methods", "METHOD", f"only these, of {methods}", shown=shown, nargs="+")


@command("comparisons:modes")
def compare_modes(parser: ArgumentParser) -> None:
    """A task with the base held by wheels, and floating, side by side.

    Do a scenario's task with the attitude held by its wheels (or thrusters) all the time, and floating: with
    coupling used and the base then turned back, with the attitude restored by the arm alone, and straight.
    Prints one table, and writes modes.json and one figure. The scenario needs a table [wheels] or
    [thrusters].

    example: ffsms-pin compare-modes mine.toml
    """
    add_scenario(parser, "-modes", "a scenario file (TOML) with wheels or thrusters")


@command("comparisons:laws", "0 done, however well the laws did; 2 bad input")
def laws(parser: ArgumentParser) -> None:
    """Follow a scenario under every control law, side by side.

    All meet the same plant, sensors, disturbances and start. The law of the scenario has the gains of its
    [control] table, the others those of [laws.NAME], or their defaults. Prints one table, and writes
    laws.json and one figure (pdf and png).

    example: ffsms-pin laws wrong-model
    """
    add_scenario(parser, "-laws", PACKAGED_OR_FILE)
    laws = "sliding-mode, passivity, super-twisting, computed-torque, pd, impedance, admittance"
    option(parser, "--laws", "LAW", f"only these, of {laws}", shown="all", nargs="+")


@command("comparisons:plants", "0 done, however many arrived; 2 bad input", resumes=True)
def robustness(parser: ArgumentParser) -> None:
    """Follow a scenario on random plants, planned again and planned once.

    All else is as the scenario says. Each plant is met twice: planned again in the loop, and by the plan that
    was made for the model. Both methods meet the same plants. Prints one table, and writes robustness.json
    and one figure (pdf and png). Runs that are done are kept in a folder beside the results until these are
    written: the same command goes on where it was killed.

    example: ffsms-pin robustness case-1 --plants 50 --jobs 2
    """
    add_scenario(parser, "-robustness", PACKAGED_OR_FILE)
    option(parser, "--plants", "N", "how many", 200)
    option(parser, "--seed", "N", "of the plants", 1)
    add_jobs(parser)
    for name, default, what in (
        ("arm-mass", 0.2, "the mass of every body of the arm, inertia with it"),
        ("base-mass", 0.1, "the mass of the base"),
        ("base-inertia", 0.1, "the inertia of the base"),
    ):
        option(parser, f"--{name}", "SHARE", f"by what share {what} is off at most", default)


@command("many:campaign", "0 done, however many arrived; 2 bad input, or the run cannot go on", resumes=True)
def campaign(parser: ArgumentParser) -> None:
    """Run a scenario many times with drawn plants, targets, noise and faults.

    Each run is in closed loop, and drawn from the distributions in the scenario's table [campaign.draw]
    (ffsms-pin docs campaigns). Writes one row a run to DIR/runs.parquet, a report (report.json) and figures.
    What is killed goes on where it was with the same command, and ends with the same table, whatever the
    number of workers and shards.

    For example:
      ffsms-pin campaign mine.toml --runs 10000 --out mine          one process a core
      ffsms-pin campaign mine.toml --runs 10000 --out mine --scheduler tcp://head:8786
      ffsms-pin campaign mine.toml --runs 10000 --out mine --shard 3/16     then: ffsms-pin merge mine
      ffsms-pin run --replay mine 4711                              one of its runs alone, by its seed
    """
    add_scenario(parser, "-campaign", "a scenario file (TOML) with [campaign.draw]")
    option(parser, "--runs", "N", "how many", kind=int, required=True)
    option(parser, "--seed", "N", "of the first run", shown="the file's, or 1", kind=int)
    add_work(parser.add_mutually_exclusive_group())


@command("many:merge", "0 done; 2 bad input, or runs are missing")
def merge(parser: ArgumentParser) -> None:
    """Make the table of a campaign that was run in shards.

    Writes one table of its chunks (DIR/runs.parquet), a report (report.json) and figures.

    example: ffsms-pin merge results/mine
    """
    parser.add_argument("folder", metavar="DIR", help="the campaign's --out")
    flag(parser, "--partial", "take what is done where runs are missing")


@command("many:sample", resumes=True)
def atlas(parser: ArgumentParser) -> None:
    """Sample a robot's coupling over its joints or its workspace.

    It measures at each configuration: singular values and entropy of the coupling, manipulability of J*, how
    far the base moves for a metre of the end effector, and the coupling assistance along chosen directions.
    Writes an xarray dataset (Zarr), and figures if asked for. A killed run goes on with the same command.

    example: ffsms-pin atlas planar_3r --over workspace --samples 1000000 --out planar.zarr --figures planar
    """
    add_robot(parser)
    words = "one row a sample, or statistics in each cell of the workspace"
    option(parser, "--over", None, words, "joints", choices=("joints", "workspace"))
    option(parser, "--samples", "N", "how many", 100_000)
    words = "points that fill the joint ranges evenly, or the same number on each joint"
    option(parser, "--method", None, words, "sobol", choices=("sobol", "grid"))
    option(parser, "--seed", "N", "of the points", 0)
    words = "for the coupling assistance, base axes; may be given several times"
    parser.add_argument(
        "--direction", metavar=("X", "Y", "Z"), nargs=3, type=float, action="append", default=[], help=words
    )
    option(parser, "--cells", "N", "along the workspace's longest side", 48)
    option(parser, "--out", "FILE", "the dataset", shown="MODEL-OVER.zarr")
    option(parser, "--figures", "DIR", "folder for figures (pdf and png)")
    add_work(parser)


@command("many:designs", resumes=True)
def sweep(parser: ArgumentParser) -> None:
    """Measure changed designs of a robot.

    It measures each combination of the changes: reach, base motion for a metre of the end effector, entropy
    and manipulability; with --wheel, also what the wheels would have to hold. Prints the designs that no
    other one beats both in reach and in base rotation, and writes sweep.json and one figure (pdf and png).

      --vary base_mass=0.5,1,2        factor of the base's mass, its inertia in proportion
      --vary base_inertia=0.5,1,2     factor of its inertia besides
      --vary mount_y=0,0.2            shift of the mount point, base axes [m]; also mount_x, mount_z
      --vary link:joint_2=0.8:1.2:5   factor of the length of the link behind a joint; first:last:count

    example: ffsms-pin sweep planar_3r --vary base_mass=0.5,1,2,4 --vary link:joint_2=0.8:1.2:5
    """
    add_robot(parser)
    words = "a continuous joint of the URDF file that is a reaction wheel; again for each wheel"
    parser.add_argument("--wheel", metavar="JOINT", action="append", default=[], help=words)
    option(parser, "--vary", "NAME=VALUES", "a parameter; see above", action="append", required=True)
    option(parser, "--samples", "N", "configurations a design", 16384)
    option(parser, "--seed", "N", "of the configurations", 0)
    option(parser, "--out", "DIR", "folder for the results", shown="results/MODEL-sweep")
    add_work(parser)


@command("info:info")
def info(parser: ArgumentParser) -> None:
    """Show a robot.

    Masses, joint limits, how well conditioned its base inertia is, and its dynamic coupling.

    example: ffsms-pin info planar_3r --joints-deg 1 1 1
    """
    add_robot(parser)
    words = "posture for the coupling, one a joint"
    shown = "zero, or the middle of the limits where zero is outside"
    option(parser, "--joints-deg", "ANGLE", words, shown=shown, kind=float, nargs="+")


@command("info:inspected", "0 the file, or the mended one, loads; 1 it does not; 2 bad input, or no mending")
def inspect(parser: ArgumentParser) -> None:
    """Look for faults in a URDF file, and mend them.

    It shows masses and inertias link by link, joint limits, and everything that is wrong. With --repair,
    write a file that loads, and list every change; what cannot be mended is said, and nothing is written
    then.

    example: ffsms-pin inspect robot.urdf --repair mended.urdf
    """
    parser.add_argument("file", metavar="FILE", help="a URDF file, or the name of a packaged robot")
    option(parser, "--repair", "OUT", "write a URDF that loads, and list the changes")
    words = "limit for joints without one, with --repair"
    option(parser, "--rate", "LIMIT", f"rate {words} [rad/s or m/s]", shown="0.5", kind=float)
    option(parser, "--effort", "LIMIT", f"torque or force {words} [N m or N]", shown="100", kind=float)


@command("view:run")
def view(parser: ArgumentParser) -> None:
    """Animate results in the browser, as one HTML file.

    It shows what `ffsms-pin run` wrote: the satellite and its arm in motion, with the coupling drawn on them,
    and obstacles, client, wheels and thrusters. Writes one HTML file that needs nothing else, not even a
    network; without --html it is view.html in the results. With --record it writes a film instead.

    For example:
      ffsms-pin view results/case-2                        write results/case-2/view.html, and open it
      ffsms-pin view results/case-2 --html out.html        write the file only
      ffsms-pin view results/capture --record out.gif --speed 2 --camera side
      ffsms-pin view results/case-2 --robot mine.urdf      a robot that was a file

    Recording needs Chromium or Chrome, which draws without a window, and pip install 'ffsms-pin[record]'.
    """
    parser.add_argument("results", metavar="RESULTS", help="folder that `ffsms-pin run` wrote")
    option(parser, "--html", "FILE", "write this file, and do not open it")
    flag(parser, "--plan", "show the plan as planned, not the simulated motion")
    words = "the robot, or the scenario file that names it, where the results cannot say"
    option(parser, "--robot", "ROBOT", words)
    option(parser, "--end-effector", "FRAME", "with --robot: the frame that is meant")
    option(parser, "--speed", "TIMES", "2 plays twice as fast as true", 1.0)
    words = "first seen from: free, front (from +x), side (from -y), top, or base, which turns with the base"
    option(parser, "--camera", "VIEW", words, "free")
    option(parser, "--show", "LAYERS", "what is visible at first: 'all', or names with commas between")
    film = parser.add_argument_group("films")
    option(film, "--record", "FILE", "write a film of one pass, to a .gif or .mp4")
    option(film, "--fps", "N", "pictures a second", shown="20; mp4: 30", kind=float)
    option(film, "--size", "WxH", "of the pictures in pixels", "800x600")
    option(film, "--browser", "PROGRAM", "Chromium or Chrome", shown="the first found")


@command("docs:page")
def docs(parser: ArgumentParser) -> None:
    """Show a page of the documentation.

    The pages are those of this version; without a name they are listed.

    example: ffsms-pin docs scenarios
    """
    parser.add_argument("page", metavar="PAGE", nargs="?", help="name of a page (default: list them)")
    flag(parser, "--path", "print where its file is, not what it says")
