"""Margins about the axes of a figure, from one measurement of their labels."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.layout_engine import LayoutEngine
from matplotlib.transforms import Bbox

PAD = 0.05  # inch, around axes with their labels
BEFORE = {
    "left": 0.9,
    "right": 0.3,
    "bottom": 0.6,
    "top": 0.5,
}  # inch, until labels are measured; less in a small figure


class MeasuredMargins(LayoutEngine):
    """Layout of a grid of axes: titles above, legends of the figure below, equal sizes of all axes.

    Matplotlib's constrained layout measures all labels twice as often, which takes longer than to draw them.

    Attributes
    ----------
    pad
        Space around axes with their labels [inch].
    below
        Space to leave free at the bottom [inch], besides legends that take part in the layout.
    """

    _adjust_compatible = True  # with Figure.subplots_adjust
    _colorbar_gridspec = True  # a colour bar shares the cell of its axes

    def __init__(self) -> None:
        super().__init__()
        self.pad, self.below = PAD, 0.0

    def execute(self, fig: Figure) -> None:
        """Set the margins of a figure."""
        width, height = fig.get_size_inches()
        sides = _sides(fig) / fig.dpi
        left, right = (np.maximum(0, sides[place].max(axis=0)) + self.pad for place in (0, 1))
        bottom, top = (np.maximum(0, sides[place].max(axis=1)) + self.pad for place in (2, 3))
        titles = [text for text in fig.texts if text.get_in_layout()]
        legends = [item.get_window_extent().height / fig.dpi for item in fig.legends if item.get_in_layout()]
        for title in titles:
            title.set_y(1 - self.pad / height)
            top[0] += title.get_window_extent().height / fig.dpi + self.pad
        bottom[-1] += self.below + sum(legends) + self.pad * len(legends)
        across, down = max([0.0, *(right[:-1] + left[1:])]), max([0.0, *(bottom[:-1] + top[1:])])
        n_y, n_x = sides.shape[1:]
        cell_width = (width - left[0] - right[-1] - across * (n_x - 1)) / n_x
        cell_height = (height - bottom[-1] - top[0] - down * (n_y - 1)) / n_y
        if min(cell_width, cell_height) > 0:  # or labels fill the figure
            fig.subplots_adjust(
                left=left[0] / width,
                right=1 - right[-1] / width,
                bottom=bottom[-1] / height,
                top=1 - top[0] / height,
                wspace=across / cell_width,
                hspace=down / cell_height,
            )


def _sides(fig: Figure) -> np.ndarray:
    """Measure how far labels reach beyond the cells of the grid, (4, n_row, n_column) [pixel]; -inf without axes."""
    boxes: dict[SubplotSpec, list[Bbox]] = {}
    for axes in fig.axes:
        cell = axes.get_subplotspec().get_topmost_subplotspec()
        boxes.setdefault(cell, []).append(axes.get_tightbbox(for_layout_only=True))
    grid = next(iter(boxes)).get_gridspec()
    sides = np.full((4, grid.nrows, grid.ncols), -np.inf)
    for cell, found in boxes.items():
        inside, whole = cell.get_position(fig).transformed(fig.transSubfigure), Bbox.union(found)
        place = cell.rowspan.start, cell.colspan.start
        sides[(slice(None), *place)] = (
            inside.x0 - whole.x0,
            whole.x1 - inside.x1,
            inside.y0 - whole.y0,
            whole.y1 - inside.y1,
        )
    return sides
