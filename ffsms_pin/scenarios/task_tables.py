"""Tables of a scenario file about the task: where to go, whom to meet, what to keep clear of."""

from __future__ import annotations

from typing import Literal

from ffsms_pin.scenarios.keys import *


class Target(Keys):
    """[target]: where the end effector goes."""

    position: Vector3 = key("m", "", "of the end effector")
    rpy: Vector3 = angle("rad", "any attitude")
    """attitude of the end-effector frame: roll, pitch and yaw, about the axes of `relative_to`"""
    relative_to: Literal["inertial", "base", "start"] = key("", '"inertial"')
    """what position, attitude and velocities are given in: "inertial" axes; the frame of the "base", or of
    the end effector ("start"), each where it is at the start of the motion. The target does not move with
    them"""
    velocity: Vector3 = key("m/s", "0")
    """the target moves: it is at `position` at the start, and the end effector meets it at the deadline with
    this velocity"""
    spin: Vector3 = angle("rad/s", "0")
    """the target turns: its attitude is `rpy` at the start, and its angular velocity is this"""
    arrival_velocity: Vector3 = key("m/s", "0", "of the end effector at the deadline, at a target at rest")
    arrival_spin: Vector3 = angle("rad/s", "0")
    """its angular velocity then; needs `rpy` and `arrival_velocity`"""
    tolerance: Positive = key("m, rad, m/s, rad/s", "1e-3", "at the deadline, see `opt.Goal`")
    orientation_reach: Positive = angle("rad", "0.02", "how far its attitude may be off in the last tenth")


class AlsoGoal(Keys):
    """[[also]]: the goal of another frame."""

    frame: Text = key("", "", "name of a frame of the robot: a link or a joint", required=True)
    position: Vector3 = key("m", "", "where it should be; it stands still", required=True)
    rpy: Vector3 = angle("rad", "any attitude", "its attitude, as for [target]")
    relative_to: Literal["inertial", "base", "start"] = key("", '"inertial"')
    """as for [target]; "start" is this frame itself at the start of the motion"""
    tolerance: Positive = key("m, rad", "1e-3", "at the deadline")
    reach: Positive = key("m", "0.02", "how far it may be off in the last tenth of the time")
    orientation_reach: Positive = angle("rad", "0.02", "how far its attitude may be off then")


class Waypoint(Keys):
    """[[via]]: a place on the way."""

    name: Text = key("", '"via 1", ...', "for messages and for `Trajectory.binding`")
    position: Vector3 = key("m", "", "where", required=True)
    rpy: Vector3 = angle("rad", "any attitude", "attitude of the end effector there, as for [target]")
    relative_to: Literal["inertial", "base", "start"] = key("", '"inertial"', "as for [target]")
    time: NotNegative = key("s", "any", "when, from the start")
    reach: Positive = key("m", "0.01", "how near it passes")
    orientation_reach: Positive = angle("rad", "0.02", "how near to the attitude")


class Sensor(Keys):
    """[client.sensor]: how the client is seen in the loop."""

    position_noise: Positive = key("m", "0.002", "one standard deviation of each axis")
    attitude_noise: Positive = angle("rad", "0.005", "")
    velocity_noise: Positive = key("m/s", "0.002", "")
    rate_noise: Positive = angle("rad/s", "0.002", "")
    latency: NotNegative = key("s", "0.1", "age of a measurement when it arrives")
    period: Positive = key("s", "0.1", "between two of them")
    seed: Whole = key("", "0", "of the noise")
    outliers: Share = key("", "0", "share of the measurements that are grossly wrong")
    outlier_size: Positive = key("", "100", "how many times as large their noise is")
    dropouts: Share = key("", "0", "share of the measurements that are lost")
    hidden: Spans = key("s", "never", "pairs of times, from when to when nothing is seen")


class Belief(Keys):
    """[client.belief]: what is believed of the client's mass and inertia where these are not known."""

    mass: Positive = key("kg", "that of [client]", "")
    inertia: Inertia = key("kg m²", "that of [client]", "as there")
    mass_deviation: Share = key("", "0", "one standard deviation of the mass, as a share of it")
    inertia_deviation: Share = key("", "0", "likewise of the principal inertias, see `ClientEstimate`")


class ClientBody(Keys):
    """[client]: a free rigid body that is met and captured."""

    mass: Positive = key("kg", "", "", required=True)
    inertia: Inertia = key("kg m²", "", required=True)
    """about its centre of mass: the principal ones along its axes, or a 3 x 3 matrix"""
    position: Vector3 = key("m", "", "where its centre of mass is at the start")
    rpy: Vector3 = angle("rad", "0", "and its roll, pitch and yaw")
    joints: Numbers = angle("rad or m", "")
    """in place of these: at the deadline its grasp is where a straight move to these joints ends"""
    velocity: Vector3 = key("m/s", "0")
    """of its centre of mass, inertial axes; at the start, or with `joints` at the deadline"""
    spin: Vector3 = angle("rad/s", "0", "its angular velocity, likewise")
    size: Sizes3 = key("m", "")
    """sides of the box that is drawn; it is kept clear of only as an [[obstacle]] with on = "client"."""
    sensor: Sensor = table()
    belief: Belief = table()


class Meeting(Keys):
    """[meet]: the end effector at the grasp at the deadline, without relative velocity."""

    grasp: Vector3 = key("m", "0", "where the grasp frame is, in the client's axes, from its centre of mass")
    grasp_rpy: Vector3 = angle("rad", "0", "its roll, pitch and yaw against the client's axes")
    standoff: NotNegative = key("m", "0.15", "length of the corridor of approach; 0: none")
    half_angle: Positive = angle("rad", "0.35", "of the corridor")
    axis: Vector3 = key("", "[0, 0, 1]", "direction of approach, in grasp axes")
    tolerance: Positive = key("m, rad, m/s, rad/s", "1e-3", "at the contact")
    reach: Positive = key("m", "0.02", "how far it may be off in the last tenth of the time")
    orientation_reach: Positive = angle("rad", "0.2", "how far its attitude may be off then")
    rest_after: bool = key("", "false", "whether the servicer has the momentum that leaves both at rest")


class Envelope(Keys):
    """[contact.envelope]: how near its grasp, and how slowly past it, the gripper takes hold."""

    distance: Positive = key("m", "0.05", "between end effector and grasp")
    turn: Positive = angle("rad", "0.1", "likewise")
    speed: Positive = key("m/s", "0.05", "of the end effector, relative to the grasp")
    spin: Positive = angle("rad/s", "0.05", "likewise")
    force: Positive = key("N", "any", "that a compliant grip is expected to bear, see `contact_load`")
    torque: Positive = key("N m", "any", "likewise")


class Go(Keys):
    """[contact.go]: what must be known of the client from the go decision to the contact."""

    age: Positive = key("s", "the latency and 2 s, or 5 periods", "since the last measurement was made")
    distance: Positive = key("m", "that of [contact.envelope]")
    """three standard deviations of the grasp's place at the contact, as predicted; by default at most the
    half width of the corridor at its mouth"""
    turn: Positive = angle("rad", "that of [contact.envelope]", "the same of its attitude")


class Masses(Keys):
    """[contact.masses]: what is not known of the servicer's masses, one standard deviation as a share."""

    arm: Share = key("", "as [plant] has it", "of each of the arm's bodies, its inertia with it")
    base: Share = key("", "as [plant] has it", "of the base's mass")
    base_inertia: Share = key("", "as [plant] has it")
    """of the base's inertia. By default all three are as large as what [plant.random] draws, and as what
    [plant] sets"""


class Nozzle(Keys):
    """[contact.nozzle]: a cone and a throat round the grasp guide a probe whose tip is the end effector."""

    probe_length: Positive = key("m", "0.72", "of the rod behind the tip")
    probe_radius: Positive = key("m", "0.008", "of the rod, and of its round tip")
    entry_radius: Positive = key("m", "0.142", "of the cone where it begins")
    throat_radius: Positive = key("m", "0.0094", "of the tube that it ends in")
    cone_length: Positive = key("m", "0.4285", "")
    throat_length: Positive = key("m", "0.0445", "")
    depth: NotNegative = key("m", "0.037", "of the grasp in the throat")
    stiffness: Positive = key("N/m", "5000", "of rod and walls, see `SurfaceContact`")
    damping: NotNegative = key("s/m", "20", "share of the speed that a contact takes, for each m/s of it")
    friction: NotNegative = key("", "0.2", "coefficient")


class Ring(Keys):
    """[contact.ring]: an open gripper, amid whose pads the end effector is, round the rim of a ring."""

    opening: Positive = key("m", "0.04", "between the fingers' pads")
    ring_radius: Positive = key("m", "0.597", "of the middle of its wall")
    thickness: Positive = key("m", "0.005", "of its wall")
    height: Positive = key("m", "0.06", "by which it stands out")
    reach: Positive = key("m", "0.025", "from the palm to the middle of the pads")
    pad: Positive = key("m", "0.04", "side of a square pad")
    pad_radius: Positive = key("m", "0.01", "of the balls at its corners")
    stiffness: Positive = key("N/m^(3/2)", "8.7e5", "of pads and rim, see `SurfaceContact`")
    damping: NotNegative = key("s/m", "20", "share of the speed that a contact takes, for each m/s of it")
    friction: NotNegative = key("", "0.2", "coefficient")


class Contact(Keys):
    """[contact]: how the client is caught, and what follows."""

    kind: Literal["rigid", "compliant"] = key("", '"rigid"')
    """a weld at once; "compliant": a spring and a damper for a while, then a weld"""
    stiffness: Positive = key("N/m", "500", "of a compliant grasp")
    damping: NotNegative = key("N s/m", "50", "likewise")
    turn_stiffness: Positive = key("N m/rad", "20", "likewise")
    turn_damping: NotNegative = key("N m s/rad", "2", "likewise")
    time: Positive = key("s", "0.5", "after which a compliant grasp is rigid")
    torque_share: Positive = key("", "0.5", "of the torque limits that braking may need")
    after: NotNegative = key("s", "10", "simulated after the capture, or after the arm gave up")
    attempts: Tries = key("", "2", "how often it is tried; after a miss the arm goes back and plans again")
    retreat: Positive = key("m", "0.3", "how far it goes back from the grasp then")
    keep_clear: Positive = key("s", "600")
    """after an attempt that was given up the arm rests where servicer and client keep clear of each other for
    this time, as predicted"""
    envelope: Envelope = table()
    go: Go = table()
    masses: Masses = table()
    nozzle: Nozzle = table()
    ring: Ring = table()


class ObstacleBody(Keys):
    """[[obstacle]]: a body to keep clear of."""

    shape: Literal["box", "sphere", "cylinder", "capsule", "mesh"] = key("", "", required=True)
    """"box", "sphere", "cylinder", "capsule", "mesh"."""
    size: Sizes3 = key("m", "", "of a box: its three sides")
    radius: Positive = key("m", "", "of a sphere, cylinder or capsule")
    length: Positive = key("m", "")
    """of a cylinder along its z axis, and of a capsule between the centres of its ends"""
    file: Text = key("", "", "of a mesh, which must be convex: a path from the file's folder")
    scale: Positive = key("", "1", "of a mesh")
    position: Vector3 = key("m", "0", "of the shape's centre (of a mesh's origin)")
    rpy: Vector3 = angle("rad", "0", "its roll, pitch and yaw, as in a URDF")
    on: Literal["inertial", "base", "client"] = key("", '"inertial"')
    """what position and attitude are fixed to: "inertial" axes, the "base" link's frame, or the "client"'s"""
    margin: NotNegative = key("m", "0", "what is kept beyond the clearance")
    name: Text = key("", "", "for messages. Default: the shape and its place in the list")
