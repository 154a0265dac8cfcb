"""Test obstacles in the viewer's scene and in the drawing of the motion."""

from __future__ import annotations

import coal
import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
import pytest
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.geometry.convex_parts import outline
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.plotting.motion import plot_motion
from ffsms_pin.viewer import view

SHAPES = [
    coal.Box(0.1, 0.2, 0.3),
    coal.Sphere(0.1),
    coal.Cylinder(0.1, 0.3),
    coal.Capsule(0.1, 0.2),
    coal.Cone(0.1, 0.2),
    coal.Ellipsoid(0.1, 0.2, 0.3),
]


@pytest.fixture(scope="module")
def moved(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    problem = opt.Problem(planar, planar.configuration([0.4, 0.7, -0.5]), [0.5, 0.5, 0.0], 2.0, 0.5)
    return measure(problem, 0.1 * np.ones((5, 3)))


@pytest.mark.parametrize("shape", SHAPES)
def test_outlines_lie_on_the_shape(shape: coal.ShapeBase) -> None:
    obstacle = opt.Obstacle(shape)
    points = outline(shape)
    assert (
        max(abs(obstacle.distance(point, 0.0)) for point in points[ConvexHull(points).vertices][::7]) < 1e-4
    )
    shape.computeLocalAABB()
    # Circles are polygons with 32 corners.
    np.testing.assert_allclose(points.max(axis=0), shape.aabb_local.max_, atol=2e-3)


def test_layers_and_drawings(planar: ffsms.SpaceManipulator, moved: opt.Trajectory) -> None:
    here = pin.SE3(np.eye(3), np.array([0.2, 0.9, 0.0]))
    obstacles = [opt.Obstacle(SHAPES[0], here), opt.Obstacle(SHAPES[1], here, "base")]
    assert view(planar, moved, obstacles=obstacles).layers["obstacles"]
    assert "obstacles" not in view(planar, moved).layers
    ax = plot_motion(planar, moved, obstacles=obstacles)
    plain = plot_motion(planar, moved)
    count = [sum(isinstance(patch, Polygon) for patch in axes.patches) for axes in (ax, plain)]
    assert count[0] - count[1] == 3  # the obstacle on the base is drawn at the start and at the end
    plt.close("all")
