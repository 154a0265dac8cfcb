"""`opt.check`: correct parts pass, and mistakes are named."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from part_cases import problem_of, with_wheels_and_thrusters

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import FfsmsWarning, PartError

ROBOTS = ["planar_3r", "satellite_panda"]
ATTITUDE_MODE = "rotation-floating"


class SlackOf(opt.Inequality):
    """A limit that keeps a function of the variables above zero."""

    name = "slack of"

    def __init__(self, slack: Callable[[opt.Variables], Any]) -> None:
        self._slack = slack

    def slack(self, m: opt.Variables) -> Any:
        return self._slack(m)


# Functions of accelerations, of time and of driven coordinates; and large numbers, which round.
SLACKS: dict[str, tuple[str, Callable[[opt.Variables], Any]]] = {
    "torques": ("floating", lambda m: 1.0 - abs(m.torques)),
    "accelerations": ("floating", lambda m: 1.0 - m.accelerations * m.tip[0]),
    "momentum of the arm": ("floating", lambda m: m.arm_momentum),
    "hours later": ("floating", lambda m: m.time + 1e3),
    "torques, attitude held": (ATTITUDE_MODE, lambda m: m.torques),
    "torques of wheels": (ATTITUDE_MODE, lambda m: m.wheel_torques),
    "momentum of the arm, attitude held": (ATTITUDE_MODE, lambda m: m.arm_momentum),
    "no turn": (ATTITUDE_MODE, lambda m: 1.0 - m.base.angle_from(m.rollouts.rotation_start)),
    "wrench": ("flying", lambda m: m.wrench),
    "momentum of the arm, place held": ("translation-flying", lambda m: m.arm_momentum),
}


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("name", list(SLACKS))
def test_derivatives_of_variables_pass_the_check(name: str, robot: str) -> None:
    mode, slack = SLACKS[name]
    problem = problem_of(with_wheels_and_thrusters(ffsms.load(robot)), mode=mode, joint_rates=None)
    assert opt.check(SlackOf(slack), problem) < 1e-4


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_goal_on_the_base_moves_with_it(robot: str) -> None:
    sms = ffsms.load(robot)
    problem = problem_of(sms, goal=opt.Position([0.5, 0.3, 0.1], on="base"))
    limit = SlackOf(lambda m: m.goal - m.tip)
    assert opt.check(limit, problem) < 1e-4
    slopes = limit.slacks(opt.Variables(problem.motion(0.1 * np.ones((5, sms.n)), 0.5))).slopes
    at_all_times = np.eye(3)[..., None, None] * np.ones((1, 9))
    np.testing.assert_allclose(slopes["by_base"] * np.ones((1, 9)), at_all_times, atol=1e-8)


def test_the_box_passes_the_check_with_small_singular_values() -> None:
    """The singular values of `satellite_panda` are a few 1e-4, because its base is heavy."""
    assert opt.check(opt.AlphaBox(), problem_of(ffsms.load("satellite_panda"), joint_rates=None)) < 1e-4


def test_a_term_of_absent_wheels_warns(planar: ffsms.SpaceManipulator) -> None:
    with pytest.warns(FfsmsWarning, match="zero on all random motions"):
        assert opt.check(opt.WheelMomentum(), problem_of(planar)) == 0.0


def test_distances_are_checked_to_the_accuracy_of_the_geometry() -> None:
    """Distances of round shapes have errors of 1e-8 m, so differences over 1e-6 rad have errors of 1 %."""
    sms = ffsms.load("two_arms", end_effector="left_tool")
    q0 = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper) + 0.05 * np.arange(1, 15))
    problem = opt.Problem(sms, q0, [0.5, 0.4, 0.1], 0.02, 0.01, limits=[])
    clearance = opt.Clearance().for_robot(sms)
    pair = clearance._stacks[0].names.index("left_link_4 - right_link_7")
    assert opt.check(SlackOf(lambda m: clearance.slack(m)[0][pair]), problem, tolerance=2e-3) < 2e-3


@pytest.mark.parametrize(
    ("slack", "text"),
    [
        (lambda m: np.sqrt(m.tip[0] - 100.0), "returns NaN; it must be defined"),
        (lambda m: m.tip[0] / 0.0, "failed with ZeroDivisionError"),
        (lambda m: m.frame("nowhere"), "failed with FrameNotFound: no frame 'nowhere'"),
        (
            lambda m: m.entropy[0],
            "failed with InvalidValue: index must be left out, because this variable is a number",
        ),
    ],
)
def test_mistakes_are_named(
    planar: ffsms.SpaceManipulator, slack: Callable[[opt.Variables], Any], text: str
) -> None:
    with np.errstate(all="ignore"), pytest.raises(PartError, match=rf"^SlackOf\.slack {text}"):
        opt.check(SlackOf(slack), problem_of(planar))


def test_a_limit_with_room_is_refused_with_the_new_name() -> None:
    with pytest.raises(PartError, match=r"Old\.room has the new name slack\(m\); rename the method"):

        class Old(opt.Inequality):
            name = "old"

            def room(self, m: opt.Variables) -> Any:
                return m.tip[0]
