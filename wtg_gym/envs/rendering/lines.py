"""Smooth lines drawn into a picture: the compiled part of every frame."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.compiled import compiled

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Image = npt.NDArray[np.uint8]


@compiled
def draw_traces(
    image: Image,
    x: Floats,
    traces: Floats,
    boxes: Integers,
    ranges: Floats,
    colours: Floats,
    half_width: float,
    dot_radius: float,
) -> None:
    """Draw lines over a common x, each into its box, with a dot at the end of each.

    Every column of pixels is covered from the lowest to the highest point of the line within it, half a line width
    more at both ends, and shaded by how much of a pixel that covers.

    Args:
        image: (height, width, 3), drawn into.
        x: from the left edge (0) of a box to its right one (1), rising (n,).
        traces: values of each line (n, n_lines); a line has gaps where they are not finite.
        boxes: left, top, right, bottom of each line's box, the last two exclusive (n_lines, 4) [pixels].
        ranges: values at bottom and top of the box (n_lines, 2).
        colours: 0 … 255 (n_lines, 3).
        half_width: half the width of a line [pixels].
        dot_radius: of the dot at the end, -1 for none [pixels].
    """
    n, n_lines = traces.shape
    for line in range(n_lines):
        left, top, right, bottom = boxes[line]
        low, high = ranges[line]
        width, height = right - left, bottom - top
        scale = height / (high - low)
        lowest, highest = np.full(width, math.inf), np.full(width, -math.inf)
        for i in range(n - 1):
            x0, x1 = min(x[i], 1.0) * width, min(x[i + 1], 1.0) * width
            y0, y1 = (high - traces[i, line]) * scale, (high - traces[i + 1, line]) * scale
            if not (math.isfinite(y0) and math.isfinite(y1)):
                continue
            slope = (y1 - y0) / (x1 - x0) if x1 > x0 else 0.0
            for column in range(int(x0), min(int(x1) + 1, width)):
                a = y0 + slope * (max(x0, float(column)) - x0)
                b = y0 + slope * (min(x1, column + 1.0) - x0)
                lowest[column] = min(lowest[column], a, b)
                highest[column] = max(highest[column], a, b)
        for column in range(width):
            y0, y1 = max(lowest[column] - half_width, 0.0), min(highest[column] + half_width, float(height))
            for row in range(int(min(y0, float(height))), math.ceil(max(y1, 0.0))):
                share = min(row + 1.0, y1) - max(float(row), y0)
                for c in range(3):
                    old = image[top + row, left + column, c]
                    image[top + row, left + column, c] = int(old + share * (colours[line, c] - old) + 0.5)
        y = (high - traces[n - 1, line]) * scale
        if math.isfinite(y):
            y = min(max(y, 0.0), float(height))
            _draw_dot(image, left + min(x[n - 1], 1.0) * width, top + y, dot_radius, colours[line])


@compiled
def _draw_dot(image: Image, x: float, y: float, radius: float, colour: Floats) -> None:
    reach = int(radius) + 2
    for row in range(int(y) - reach, int(y) + reach + 1):
        for column in range(int(x) - reach, int(x) + reach + 1):
            distance = math.sqrt((column + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2)
            share = min(max(radius + 0.5 - distance, 0.0), 1.0)
            for c in range(3):
                old = image[row, column, c]
                image[row, column, c] = int(old + share * (colour[c] - old) + 0.5)
