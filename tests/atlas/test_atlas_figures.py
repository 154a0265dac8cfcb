"""Figures of atlases and sweeps: drawn from what is in the file, wrong arguments named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drawn import untidy

import ffsms_pin as ffsms
from ffsms_pin.atlas import Sweep, atlas, open_atlas
from ffsms_pin.errors import InvalidValue
from ffsms_pin.plotting.atlas import (
    plot_atlas,
    plot_histogram,
    plot_joint_map,
    plot_pareto,
    plot_workspace_map,
)


def test_maps_slices_and_histograms_show_the_samples(tmp_path: Path) -> None:
    sms = ffsms.load("planar_3r")
    atlas(sms, tmp_path / "a.zarr", 3000, jobs=1)
    data = open_atlas(tmp_path / "a.zarr").load()
    assert untidy(plot_atlas(data)) == []
    atlas(sms, tmp_path / "w.zarr", 3000, over="workspace", jobs=1)
    assert untidy(plot_atlas(open_atlas(tmp_path / "w.zarr").load())) == []
    values, joints = data["entropy"].values, data["joints"].values
    whole = plot_joint_map(data, "entropy", (0, 1), bins=2).collections[0].get_array()
    assert whole is not None
    low = (joints[:, 0] < np.median(joints[:, 0])) & (joints[:, 1] < np.median(joints[:, 1]))
    assert float(np.ravel(whole)[0]) == pytest.approx(values[low].mean(), rel=0.02)
    part = plot_joint_map(data, "entropy", (0, 1), at={2: (-0.3, 0.3)}, bins=2).collections[0].get_array()
    assert part is not None
    assert not np.allclose(np.ravel(whole), np.ravel(part))
    assert len(plot_histogram(data, "base_rotation", bins=10).patches) == 10
    with pytest.raises(InvalidValue, match="leaves no sample"):
        plot_joint_map(data, "entropy", at={2: (50.0, 60.0)})
    with pytest.raises(InvalidValue, match="two different joints"):
        plot_joint_map(data, "entropy", (1, 1))
    with pytest.raises(InvalidValue, match="one number a sample"):
        plot_histogram(data, "sigma")
    with pytest.raises(InvalidValue, match="plane"):
        plot_workspace_map(data, "entropy", "xx")


def test_the_front_is_the_line_of_the_figure() -> None:
    reach, moved = np.array([1.0, 2.0, 3.0, 2.5]), np.array([0.1, 0.3, 0.4, 0.9])
    found = Sweep({"base_mass": np.arange(4.0)}, {"reach": reach, "base_rotation": moved})
    ax = plot_pareto(found)
    line, figure = ax.lines[0], ax.get_figure(root=True)
    assert figure is not None
    assert untidy(figure) == []
    assert np.asarray(line.get_xdata()).tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(InvalidValue, match="colour"):
        plot_pareto(found, colour="mount_x")
