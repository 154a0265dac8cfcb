"""The one way a quantity is drawn over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.checks import FloatArray
from ffsms_pin.plotting.style import LIMIT, applied, axes_or_new, legend_above, line

__all__ = ["plot_series"]


def plot_series(
    ax: Axes | None,
    t: FloatArray,
    values: FloatArray,
    label: str,
    names: Sequence[str] = (),
    limits: Sequence[FloatArray] = (),
    steps: bool = False,
) -> Axes:
    """Draw values (k,) or (k, m) over t (k,) [s].

    Parameters
    ----------
    ax : Axes or None
        None makes a new figure.
    t, values : ndarray
    label : str
        Of the vertical axis, with the unit.
    names : sequence of str
        Of the m lines, for the legend.
    limits : sequence of ndarray, each of shape (m,)
        Drawn dotted, in the colour of their line; those that are not finite are left out.
    steps : bool
        Whether a value holds until the next instant, instead of a straight line to it.
    """
    with applied():
        ax = axes_or_new(ax)
        columns = values.reshape(len(values), -1)
        for i in range(columns.shape[1]):
            name = names[i] if names else None
            ax.plot(t, columns[:, i], label=name, drawstyle="steps-post" if steps else "default", **line(i))
        drawn: list[float] = []
        for limit in limits:
            for i, value in enumerate(limit):
                if np.isfinite(value):
                    # A limit that several joints share is drawn once, in a colour that belongs to none.
                    shared = int(np.sum(np.isclose(limit, value))) > 1
                    if shared and any(np.isclose(value, drawn)):
                        continue
                    drawn.append(float(value))
                    ax.axhline(value, color="#555555" if shared else line(i)["color"], **LIMIT)
        if drawn:
            ax.plot([], [], color="#555555", label="limits", **LIMIT)
        ax.set_xlabel("time [s]")
        ax.set_ylabel(label)
        ax.margins(x=0.0)
        if names or drawn:
            labels = [*names, *(["limits"] if drawn else [])]
            legend_above(ax, labels)
    return ax
