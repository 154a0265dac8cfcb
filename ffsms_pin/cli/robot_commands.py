"""What the commands on robots, results and pages are called, say and take."""

from __future__ import annotations

from argparse import ArgumentParser

from ffsms_pin.cli.arguments import Command, add_robot, add_work

__all__ = ["ROBOT_COMMANDS"]


def _atlas(parser: ArgumentParser) -> None:
    add_robot(parser)
    parser.add_argument(
        "--over",
        choices=("joints", "workspace"),
        default="joints",
        help="one row a sample, or statistics in each cell of the workspace (default: joints)",
    )
    parser.add_argument(
        "--samples", type=int, metavar="N", default=100_000, help="how many (default: 100000)"
    )
    parser.add_argument(
        "--method",
        choices=("sobol", "grid"),
        default="sobol",
        help="points that fill the joint ranges evenly, or the same number on each joint (default: sobol)",
    )
    parser.add_argument("--seed", type=int, metavar="N", default=0, help="of the points (default: 0)")
    parser.add_argument(
        "--direction",
        nargs=3,
        type=float,
        action="append",
        default=[],
        metavar=("X", "Y", "Z"),
        help="for the coupling assistance, base axes; may be given several times",
    )
    parser.add_argument(
        "--cells", type=int, metavar="N", default=48, help="along the workspace's longest side (default: 48)"
    )
    parser.add_argument("--out", metavar="FILE", help="the dataset (default: MODEL-OVER.zarr)")
    parser.add_argument("--figures", metavar="DIR", help="folder for figures (pdf and png)")
    add_work(parser)


def _sweep(parser: ArgumentParser) -> None:
    add_robot(parser)
    parser.add_argument(
        "--wheel",
        action="append",
        default=[],
        metavar="JOINT",
        help="a continuous joint of the URDF file that is a reaction wheel; again for each wheel",
    )
    parser.add_argument(
        "--vary", action="append", required=True, metavar="NAME=VALUES", help="a parameter; see above"
    )
    parser.add_argument(
        "--samples", type=int, metavar="N", default=16384, help="configurations a design (default: 16384)"
    )
    parser.add_argument("--seed", type=int, metavar="N", default=0, help="of the configurations (default: 0)")
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/MODEL-sweep)")
    add_work(parser)


def _info(parser: ArgumentParser) -> None:
    add_robot(parser)
    parser.add_argument(
        "--joints-deg",
        metavar="ANGLE",
        nargs="+",
        type=float,
        help="posture for the coupling, one a joint (default: zero, or the middle of the limits"
        " where zero is outside)",
    )


def _inspect(parser: ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="a URDF file, or the name of a packaged robot")
    parser.add_argument("--repair", metavar="OUT", help="write a URDF that loads, and list the changes")
    for name, what, default in (
        ("rate", "rate", "[rad/s or m/s] (default: 0.5)"),
        ("effort", "torque or force", "[N m or N] (default: 100)"),
    ):
        words = f"{what} limit for joints without one, with --repair {default}"
        parser.add_argument(f"--{name}", type=float, metavar="LIMIT", help=words)


def _view(parser: ArgumentParser) -> None:
    parser.add_argument("results", metavar="RESULTS", help="folder that `ffsms-pin run` wrote")
    parser.add_argument("--html", metavar="FILE", help="write this file, and do not open it")
    parser.add_argument(
        "--plan", action="store_true", help="show the plan as planned, not the simulated motion"
    )
    parser.add_argument(
        "--robot",
        metavar="ROBOT",
        help="the robot, or the scenario file that names it, where the results cannot say",
    )
    parser.add_argument("--end-effector", metavar="FRAME", help="with --robot: the frame that is meant")
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="TIMES", help="2 plays twice as fast as true (default: 1)"
    )
    parser.add_argument(
        "--camera",
        metavar="VIEW",
        default="free",
        help="where it is looked at from first: free, front (from +x), side (from -y), top, or base, which "
        "turns with the base (default: free)",
    )
    parser.add_argument(
        "--show", metavar="LAYERS", help="what is visible at first: 'all', or names with commas between"
    )
    film = parser.add_argument_group("films")
    film.add_argument("--record", metavar="FILE", help="write a film of one pass, to a .gif or .mp4")
    film.add_argument("--fps", type=float, metavar="N", help="pictures a second (default: 20; mp4: 30)")
    film.add_argument(
        "--size", metavar="WxH", default="800x600", help="of the pictures in pixels (default: 800x600)"
    )
    film.add_argument("--browser", metavar="PROGRAM", help="Chromium or Chrome (default: the first found)")


def _docs(parser: ArgumentParser) -> None:
    parser.add_argument("page", metavar="PAGE", nargs="?", help="name of a page (default: list them)")
    parser.add_argument("--path", action="store_true", help="print where its file is, not what it says")


ROBOT_COMMANDS = {
    "atlas": Command(
        "atlas:run",
        "sample a robot's coupling over its joints or its workspace",
        """\
Sample a robot's configurations and measure at each: singular values and entropy of the coupling,
manipulability of J*, how far the base moves for a metre of the end effector, and the coupling assistance
along chosen directions. Writes an xarray dataset (Zarr), and figures where they are asked for. A run that was
killed goes on with the same command.

example: ffsms-pin atlas planar_3r --over workspace --samples 1000000 --out planar.zarr --figures planar
""",
        _atlas,
        resumes=True,
    ),
    "sweep": Command(
        "sweep:run",
        "measure changed designs of a robot",
        """\
Change a robot's design, and measure each combination: reach, base motion for a metre of the end effector,
entropy and manipulability; with --wheel, also what the wheels would have to hold. Prints the designs that no
other one beats both in reach and in base rotation, and writes sweep.json and one figure (pdf and png).

  --vary base_mass=0.5,1,2        factor of the base's mass, its inertia in proportion
  --vary base_inertia=0.5,1,2     factor of its inertia besides
  --vary mount_y=0,0.2            shift of the mount point, base axes [m]; also mount_x, mount_z
  --vary link:joint_2=0.8:1.2:5   factor of the length of the link behind a joint; first:last:count

example: ffsms-pin sweep planar_3r --vary base_mass=0.5,1,2,4 --vary link:joint_2=0.8:1.2:5
""",
        _sweep,
        resumes=True,
    ),
    "info": Command(
        "info:run",
        "show a robot",
        """\
Show a robot: masses, joint limits, how well conditioned its base inertia is, and its dynamic coupling.

example: ffsms-pin info planar_3r --joints-deg 1 1 1
""",
        _info,
    ),
    "inspect": Command(
        "inspect:run",
        "look for faults in a URDF file, and mend them",
        """\
Look through a URDF file: masses and inertias link by link, joint limits, and everything that is wrong.
With --repair, write a file that loads, and list every change; what cannot be mended is said, and nothing is
written then.

examples:
  ffsms-pin inspect robot.urdf
  ffsms-pin inspect robot.urdf --repair mended.urdf
""",
        _inspect,
        "0 the file, or the mended one, loads; 1 it does not; 2 bad input, or it cannot be mended",
    ),
    "view": Command(
        "view:run",
        "animate results in the browser, as one HTML file",
        """\
Show what `ffsms-pin run` wrote: the satellite and its arm in motion, with the coupling drawn on them, and
obstacles, client, wheels and thrusters. Writes one HTML file that needs nothing else, not even a network;
without --html it is view.html in the results. With --record it writes a film instead.

examples:
  ffsms-pin view results/case-2                        write results/case-2/view.html, and open it
  ffsms-pin view results/case-2 --html out.html        write the file only
  ffsms-pin view results/capture --record out.gif --speed 2 --camera side
  ffsms-pin view results/case-2 --robot mine.urdf      a robot that was a file

Recording needs Chromium or Chrome, which draws without a window, and pip install 'ffsms-pin[record]'.
""",
        _view,
    ),
    "docs": Command(
        "docs:run",
        "show a page of the documentation",
        """\
Show a page of the documentation, as it came with this version; without a name, the list of pages.

examples:
  ffsms-pin docs                  what there is
  ffsms-pin docs scenarios        every table and key of a scenario file
  ffsms-pin docs scenarios --path where the page is
""",
        _docs,
    ),
}
