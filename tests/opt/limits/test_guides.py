"""A nozzle around a probe: a hull for all other bodies, and walls for the probe."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest

from ffsms_pin import opt, scenarios
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.bodies import BodyStack
from ffsms_pin.scenarios.problems import rendezvous


class FixedClient:
    """A client that does not move."""

    def __init__(self, pose: pin.SE3) -> None:
        self.pose_ = pose

    def pose(self, t: float) -> pin.SE3:
        return self.pose_

    def poses(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.tile(self.pose_.translation, (len(times), 1)), np.tile(
            self.pose_.rotation, (len(times), 1, 1)
        )


def _distances(aside: float, back: float) -> dict[str, float]:
    """Return distances by pair; the tip is `back` [m] out of the grasp and `aside` [m] beside the axis."""
    scenario = scenarios.scenario("nozzle")
    sms = scenario.load()
    meeting = rendezvous(scenario, sms)
    scene = meeting.scene
    assert scene is not None
    q = scenario.start_configuration(sms)
    tip = sms.at(q).end_effector_pose
    grasp = tip * pin.SE3(np.eye(3), np.array([-aside, 0.0, back]))
    client = FixedClient(grasp * scene.grasp.inverse())
    stack = BodyStack(sms, "hulls", 0.01, obstacles=meeting.obstacles(client))
    values = stack.values(stack.at(q, 0.0))[:, 0] + stack.margins
    return dict(zip(stack.names, values.tolist(), strict=True))


def test_the_probe_keeps_clear_of_the_walls_and_other_bodies_of_their_hull() -> None:
    distances = _distances(0.0, 0.0)
    walls = {name for name in distances if "wall" in name}
    assert walls == {f"link_7 - nozzle wall {i}" for i in range(1, 18)}
    assert {name for name in distances if name.endswith("- nozzle")} == {
        f"{body} - nozzle" for body in ("bus", *(f"link_{i}" for i in range(1, 8)))
    }
    # The play of the probe in the throat, and the distance of the pod from the lip.
    assert min(distances[name] for name in walls) == pytest.approx(1.4e-3, abs=1e-5)
    assert distances["link_7 - nozzle"] == pytest.approx(0.512 - 0.4655, abs=2e-3)


@pytest.mark.parametrize(("aside", "back", "inside"), [(0.0, 0.3, False), (0.15, 0.2, True)])
def test_a_probe_in_a_wall_has_a_negative_distance(aside: float, back: float, inside: bool) -> None:
    least = min(value for name, value in _distances(aside, back).items() if "wall" in name)
    assert (least < 0.0) == inside


def test_walls_may_come_nearer_by_10_mm_than_in_the_grasp() -> None:
    """The relaxation applies in the throat; in front of the throat the clearance is kept."""
    scenario = scenarios.scenario("nozzle")
    sms, client = scenario.load(), FixedClient(pin.SE3.Identity())
    stack = BodyStack(sms, "hulls", 0.01, obstacles=rendezvous(scenario, sms).obstacles(client))
    front, rear = (stack.names.index(f"link_7 - nozzle wall {i}") for i in (1, 9))
    assert 0.01 + stack.margins[rear] == pytest.approx(1.4e-3 - 0.01, abs=1e-5)
    assert np.isfinite(stack.largest[rear])
    assert stack.margins[front] == 0.0


def test_a_piece_needs_a_grasp() -> None:
    whole = opt.Obstacle(coal.Sphere(0.2), grasp=pin.SE3.Identity())
    with pytest.raises(InvalidValue, match="requires grasp="):
        opt.Obstacle(coal.Sphere(0.1), piece_of=whole)


def test_the_margin_of_a_piece_does_not_loosen_its_limit() -> None:
    """For walls beside the grasped probe, the required distance does not depend on the obstacle's margin."""
    scenario = scenarios.scenario("nozzle")
    sms = scenario.load()
    meeting = rendezvous(scenario, sms)
    assert meeting.scene is not None
    grasp = sms.at(scenario.start_configuration(sms)).end_effector_pose
    obstacles = meeting.obstacles(FixedClient(grasp * meeting.scene.grasp.inverse()))
    plain, wide = (
        BodyStack(sms, "hulls", 0.01, obstacles=[replace(obstacle, margin=margin) for obstacle in obstacles])
        for margin in (0.0, 0.02)
    )
    walls = [i for i, name in enumerate(plain.names) if "wall" in name]
    near = [i for i in walls if plain.margins[i] < 0.0]
    assert near
    np.testing.assert_allclose(wide.margins[near], plain.margins[near], atol=1e-9)
    assert (wide.margins[walls] >= plain.margins[walls] - 1e-9).all()
