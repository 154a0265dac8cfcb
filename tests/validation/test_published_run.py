"""Compare a PD run that the paper's author published with `simulate` and MuJoCo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from published_run import PUBLISHED, mujoco_end, our_end, planar_robot


def test_the_final_base_pose_agrees_with_the_publication_and_with_mujoco(tmp_path: Path) -> None:
    """The published numbers are read from plots, to 2 mm and 5 mrad; engines agree to 1e-7."""
    sms = planar_robot(tmp_path)
    base = our_end(sms)
    assert (np.abs(base - PUBLISHED) < [2e-3, 2e-3, 5e-3]).all()
    np.testing.assert_allclose(base, [-0.05512, 0.00757, 0.21795], rtol=0.0, atol=5e-6)
    np.testing.assert_allclose(mujoco_end(sms), base, rtol=0.0, atol=1e-7)
