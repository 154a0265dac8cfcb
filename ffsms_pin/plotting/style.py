"""The style of all figures, readable in print, in grey, and by colour-blind readers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.textpath import TextPath
from matplotlib.ticker import ScalarFormatter

# The colours of Okabe and Ito, ordered by lightness, black last.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
_DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (5, 1.5, 1, 1.5)), (0, (2, 1)), (0, (8, 1.5, 2, 1.5)))
ACCENT, NEUTRAL = "#0072B2", "#555555"
# The style of limits.
LIMIT: dict[str, Any] = {"linestyle": ":", "linewidth": 1.1}
# The style of a plan beside the flown motion: thin and pale, in the colour of the flown motion.
PLANNED: dict[str, Any] = {"linewidth": 0.9, "linestyle": "-", "alpha": 0.55}
# The labels of limits and of plans in legends.
LIMITS, AS_PLANNED = "limits", "as planned"

_WIDTH = 5.2  # [in] width of a figure
_LEGEND_WIDTH = 38.0  # [em] largest width of a legend above a panel
_LAST = (LIMITS, AS_PLANNED)  # last entries of a legend

# The type is Any, because the type of `rc_context` depends on Matplotlib's version.
_STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "axes.linewidth": 0.8,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "legend.handlelength": 2.6,
    "lines.linewidth": 1.5,
    "figure.dpi": 100.0,
    "savefig.dpi": 160.0,
    "pdf.fonttype": 42,
    "svg.hashsalt": "ffsms-pin",  # the same internal names in every run
}


@contextmanager
def applied() -> Iterator[None]:
    """Use the style inside the block."""
    with mpl.rc_context(_STYLE):
        yield


drawing = applied()  # decorator of functions that draw


def line(index: int) -> dict[str, Any]:
    """Return the colour and the dashes of a panel's line `index`, from 0."""
    return {"color": _COLOURS[index % len(_COLOURS)], "linestyle": _DASHES[index % len(_DASHES)]}


def legend_above(ax: Axes, columns: int | None = None) -> None:
    """Draw a legend above a panel on the right, unless no line has a label.

    The power of ten of the vertical axis is above the panel on the left.
    """
    labels = ax.get_legend_handles_labels()[1]
    if not labels:
        return
    columns = columns or _columns(labels)
    corner = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0)}
    ax.legend(**corner, ncols=columns, borderaxespad=0.2, columnspacing=1.4)


def over_time(ax: Axes, label: str) -> None:
    """Set the labels of a panel over time, and remove its margins in time."""
    ax.set_xlabel("time [s]")
    ax.set_ylabel(label)
    ax.margins(x=0.0)


def _columns(labels: Sequence[str], width: float = 1.0) -> int:
    """Return the number of legend columns that fit above a total width of `width` panels."""
    for count in range(len(labels), 1, -1):
        rows = -(-len(labels) // count)
        columns = [labels[i : i + rows] for i in range(0, len(labels), rows)]
        # A column consists of a sample of the line, two gaps and the text. Sample and gaps take 4.8 em.
        needed = sum(4.8 + max(_length(label) for label in column) for column in columns)
        if needed <= width * _LEGEND_WIDTH:
            return len(columns)
    return 1


@lru_cache(maxsize=1024)
def _length(label: str) -> float:
    """Return the length of a label [em], cached because the measurement takes over ten milliseconds."""
    return float(TextPath((0.0, 0.0), label, size=10.0).get_extents().width) / 10.0


@drawing
def share_legend(figure: Figure, panels: Sequence[Axes], title: str = "") -> None:
    """Draw the title, and a common legend below it if the legends of all panels have the same entries.

    Entries for limits and for plans may differ.
    """
    legends = [legend for ax in panels if (legend := ax.get_legend()) is not None]
    entries: dict[str, Any] = {}
    own: list[list[str]] = []
    for ax in panels:
        handles, labels = ax.get_legend_handles_labels()
        own.append([label for label in labels if label not in _LAST])
        entries |= dict(zip(labels, handles, strict=True))
    if len(panels) < 2 or len(legends) < len(panels) or any(labels != own[0] for labels in own):
        if title:
            figure.suptitle(title, fontsize=9.0)
        return
    for legend in legends:
        legend.remove()
    for name in _LAST:
        if name in entries:
            entries[name] = entries.pop(name)
    columns = _columns(list(entries), figure.get_figwidth() / _WIDTH)
    # The title is that of the legend, because a title of the figure would overlap the legend.
    place = {"loc": "outside upper right", "alignment": "right"}
    heading = {"title": title or None, "title_fontsize": 9.0}
    figure.legend(entries.values(), entries.keys(), ncols=columns, **place, **heading)


class _Ticks(ScalarFormatter):
    """A formatter that writes ticks as plain text, because typesetting formulas is slow."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return the label of a tick."""
        return super().__call__(x, pos).removeprefix("$\\mathdefault{").removesuffix("}$")


def subplots(
    figure: FigureBase,
    rows: int,
    columns: int = 1,
    sharex: bool = False,
    heights: Sequence[float] | None = None,
) -> list[Axes]:
    """Add panels to a figure, row by row, inside a block of `applied`; `heights` are relative heights."""
    grid = figure.subplots(rows, columns, sharex=sharex, squeeze=False, height_ratios=heights)
    panels: list[Axes] = list(grid.ravel())
    for ax in panels:
        ax.xaxis.set_major_formatter(_Ticks())
        ax.yaxis.set_major_formatter(_Ticks())
    return panels


@drawing
def stack(rows: int, height: float = 2.1, sharex: bool = True) -> tuple[Figure, list[Axes]]:
    """Make a figure of stacked panels with a height [in] each; `sharex`: with a common horizontal axis."""
    figure = Figure(figsize=(_WIDTH, 0.4 + height * rows), layout="constrained")
    panels = subplots(figure, rows, sharex=sharex)
    figure.align_ylabels(panels)
    return figure, panels


def axes_or_new(ax: Axes | None) -> Axes:
    """Return `ax`, or the axes of a new figure if `ax` is None."""
    return ax if ax is not None else stack(1)[1][0]
