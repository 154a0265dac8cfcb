"""Arguments and help of the commands on robots and results, in the order of --help."""

from __future__ import annotations

from argparse import ArgumentParser

from ffsms_pin.cli.main import add_robot, command, flag, option


@command(
    "info:run",
    "0 the robot, or the repaired file, loads; 1 the file does not load; 2 bad input, or a file that cannot "
    "be repaired",
)
def info(parser: ArgumentParser) -> None:
    """Show a robot and what is wrong with its file.

    Prints masses, joint limits, the condition of the base inertia and the dynamic coupling. Faults of a URDF
    file are listed first, each with its repair; if the file does not load, its links and joints are listed
    as they are written. With --repair, write a file that loads, list every change, and show that robot; if a
    fault needs a value that only the author has, nothing is written.

    For example:
      ffsms-pin info planar_3r --joints-deg 1 1 1
      ffsms-pin info robot.urdf --repair repaired.urdf
    """
    add_robot(parser)
    words = "posture for the coupling, one a joint"
    shown = "zero, or the middle of the limits where zero is outside"
    option(parser, "--joints-deg", "ANGLE", words, shown=shown, kind=float, nargs="+")
    option(parser, "--repair", "OUT", "write a URDF that loads, and list the changes")
    words = "limit for joints without one, with --repair"
    option(parser, "--rate", "LIMIT", f"rate {words} [rad/s or m/s]", shown="0.5", kind=float)
    option(parser, "--effort", "LIMIT", f"torque or force {words} [N m or N]", shown="100", kind=float)


@command("export:run")
def export(parser: ArgumentParser) -> None:
    """Write a robot for other tools.

    It writes the whole robot, satellite included, as a URDF or as a MuJoCo model: names, masses, joint
    limits, shapes. Meshes of a URDF are copied into FILE_meshes beside it, those of a MuJoCo model are in it.

    For example:
      ffsms-pin export satellite_panda --urdf panda.urdf
      ffsms-pin export mine.toml --mjcf mine.xml         the robot of a scenario, mounted as it says
    """
    add_robot(parser)
    form = parser.add_mutually_exclusive_group(required=True)
    option(form, "--urdf", "FILE", "write a URDF")
    option(form, "--mjcf", "FILE", "write a MuJoCo model: a free base, no gravity, a motor a joint")


@command("view:run")
def view(parser: ArgumentParser) -> None:
    """Animate results in the browser, as one HTML file.

    It shows what `ffsms-pin run` wrote: the satellite and its arm in motion, with the coupling drawn on them,
    and obstacles, client, wheels and thrusters. Writes one HTML file that needs nothing else, not even a
    network; without --html it is view.html in the results.

    For example:
      ffsms-pin view results/case-2                        write results/case-2/view.html, and open it
      ffsms-pin view results/case-2 --html out.html        write the file only
      ffsms-pin view results/capture --speed 2 --camera side
      ffsms-pin view results/case-2 --robot mine.urdf      a robot that was a file
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
