"""Tables of a scenario file about the robot: its model, its limits, its satellite, what acts on the base."""

from __future__ import annotations

from typing import Literal

from ffsms_pin.scenarios.keys import *


class Mount(Keys):
    """[robot.mount]: `[robot] model` is an arm, put on a satellite: `ffsms_pin.mount`."""

    mass: Positive = key("kg", "200", "of the satellite's body, panels included")
    size: Sizes3 = key("m", "[1, 1, 1]", "its length, width and height along x, y and z")
    inertia: Inertia = key("kg m²", "a solid box")
    """about its centre of mass: the principal ones along its axes, or a 3 x 3 matrix"""
    com: Vector3 = key("m", "the box's centre", "its centre of mass in the base frame, the box's centre")
    panels: Sizes2 = key("m", "none", "span and chord of two solar panels, which are drawn only")
    position: Vector3 = key("m", "centre of the +x face")
    """where the arm's root link is in the base frame, the box's centre"""
    rpy: Vector3 = angle("rad", "[0, 1.5708, 0]")
    """its roll, pitch and yaw there. Default: the arm's z axis along the base's x"""


class Robot(Keys):
    """[robot]: the robot, by name or file."""

    model: Text = key("", "", required=True)
    """a robot that `ffsms_pin.load` knows, as `planar_3r` or `satellite_panda`, or a URDF's path from the
    file's folder"""
    end_effector: Text = key("", "the last link's frame")
    """a frame of it; needed where the arm has several last links"""
    base_size: Sizes3 = key("m", "the URDF's box", "length, width and height of the base")
    wheels: Texts = key("", "none")
    """names of joints of the URDF that are reaction wheels: no joints of the arm"""
    locked: ByJoint = angle("rad or m", "none")
    """joints that become fixed, and where, by name: `{joint_2 = 0.5}`. They are then no joints of the robot;
    those under [plan] stay joints. `locked_deg` is for joints that turn"""
    velocity: PerJointPositive = angle("rad/s or m/s", "the file's")
    """rate limits in place of the file's, which may then be missing or zero; per joint"""
    acceleration: PerJointPositive = angle("rad/s² or m/s²", "1.25 /s times the rate limits")
    """acceleration limits; per joint"""
    torque: PerJointPositive = key("N m or N", "the file's")
    """torque limits in place of the file's, which may then be zero; per joint"""
    inertias: Literal["check", "keep", "repair"] = key("", '"check"')
    """what happens to a link's inertia that no rigid body has: "check": an error; "keep": used as published,
    with a warning; "repair": the nearest one of a rigid body, with a warning"""
    package_dirs: Texts = key("", "none")
    """folders, from the file's, in which `package://` names of meshes are looked for, too"""
    mount: Mount = table()


class Start(Keys):
    """[start]: the base is unturned, the centre of mass of the whole system at the inertial origin."""

    joints: Numbers = angle("rad or m", "", "where the joints start, one each", required=True)
    joint_rates: PerJoint = angle("rad/s or m/s", "0")
    """how fast they move at the start, in the plan and in the closed loop; per joint"""


class Limits(Keys):
    """[limits]: in place of the URDF's."""

    lower: PerJoint = angle("rad or m", "the URDF's", "position limit, per joint")
    upper: PerJoint = angle("rad or m", "the URDF's", "position limit, per joint")
    velocity: PerJointPositive = angle("rad/s or m/s", "the URDF's", "rate limit, per joint")
    acceleration: PerJointPositive = angle("rad/s² or m/s²", "1.25 /s times the rate limit")
    """per joint; a URDF has no place for it, and this is the paper's ratio"""
    torque: PerJointPositive = key("N m or N", "the URDF's", "per joint")


class Wheels(Keys):
    """[wheels]: reaction wheels of the base."""

    axes: Rows = key("", "", required=True)
    """spin axes: a list of rows of 3 numbers, root axes, of any length but zero"""
    inertia: PerJointPositive = key("kg m²", "", "about the spin axis; per wheel", required=True)
    torque: PerJointLimit = key("N m", "inf", "largest motor torque; per wheel")
    momentum: PerJointLimit = key("N m s", "inf", "largest spin momentum; per wheel")
    friction: PerJointNotNegative = key("N m s/rad", "0", "viscous, in the bearing; per wheel")
    coulomb: PerJointNotNegative = key("N m", "0", "dry, in the bearing; per wheel")
    transition: Positive = key("rad/s", "1", "speed at which three quarters of the dry friction are there")
    names: Texts = key("", '"wheel 1", ...', "for messages")


class Thrusters(Keys):
    """[thrusters]: they act on the base."""

    places: Rows = key("m", "", required=True)
    """where the forces act: a list of rows of 3 numbers, root frame"""
    directions: Rows = key("", "", required=True)
    """of the forces on the satellite, root axes, of any length but zero"""
    force: PerJointPositive = key("N", "", "largest; one number, or one a thruster", required=True)
    least_on_time: NotNegative = key("s", "0", "shortest pulse")
    proportional: bool = key("", "false")
    """whether any force up to the largest can be had; else there are pulses, and `least_on_time` or `period`
    must be given"""
    specific_impulse: Positive = key("s", "220", "")
    period: Positive = key("s", "10 least_on_time", "from pulse to pulse")


class Dump(Keys):
    """[attitude.dump]: thrusters take momentum out of the wheels."""

    above: Positive = key("", "0.8")
    """it begins where a wheel has more than this share of its largest momentum"""
    below: NotNegative = key("", "0.1", "it ends where all have less")
    time_constant: Positive = key("s", "20", "in which the momentum falls by a factor e")


class Attitude(Keys):
    """[attitude]: the law of the base."""

    law: Literal["quaternion", "coordinated", "station-keeping"] = key("", '"quaternion"')
    """"quaternion": feedback, beside any law of [control]; "coordinated": arm and base by one model, with
    `law = "computed-torque"` and its gains under [control]; "station-keeping": thrusters hold the base's
    place too"""
    holds: Literal["both", "place"] = key("", '"both"')
    """of "station-keeping": "both", place and attitude, for `mode = "flying"`; "place", for `mode =
    "translation-flying"`"""
    bandwidth: Positive = key("rad/s", "1", "of the attitude loop")
    damping: Positive = key("", "1", "1 is critical")
    feedforward: Literal["torque", "plan", "none"] = key("", '"torque"')
    """of "quaternion": "torque", the reaction to the joint torques; "plan", to the planned joint motion;
    "none"."""
    attitude: Vector3 = angle("rad", "that at the start", "roll, pitch, yaw of the root frame to hold")
    place: Vector3 = key("m", "that at the start")
    """of "station-keeping": the base's centre of mass to hold, inertial axes"""
    dump: Dump = table()
