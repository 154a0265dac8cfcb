"""Arguments and help of the commands on robots and results, in the order of --help."""

from __future__ import annotations

from argparse import ArgumentParser

from ffsms_pin.cli.main import add_robot, add_work, command, flag, option


@command("many:sample", resumes=True)
def atlas(parser: ArgumentParser) -> None:
    """Sample a robot's coupling over its joints or its workspace.

    It measures at each configuration: singular values and entropy of the coupling, manipulability of J*, how
    far the base moves for a metre of the end effector, and the coupling assistance along chosen directions.
    Writes an xarray dataset (Zarr), and figures where they are asked for. A run that was killed goes on with
    the same command.

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
