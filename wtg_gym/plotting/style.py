"""How every figure looks: sizes, fonts, a colour and a dash pattern per law, and files that repeat bit for bit.

Figures are built without pyplot, so that nothing global changes and no window opens; matplotlib is imported by the
functions that draw.
"""

import functools
import io
import itertools
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec

from wtg_gym.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Parameters = ParamSpec("Parameters")
#: On and off lengths in line widths, after an offset; or a solid line.
Dashes = tuple[float, tuple[float, ...]] | Literal["-"]

#: The palette of Okabe and Ito, which colour-blind readers can tell apart; yellow, weak on white, comes last.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
#: Widths of one and of two columns of an IEEE journal [mm].
SINGLE_COLUMN_MM, DOUBLE_COLUMN_MM = 88.9, 181.9
#: Grey of reference lines.
REFERENCE_GREY = "0.4"
SMALL_PT = 7.0
_DPI, _MM_PER_INCH = 300, 25.4


@dataclass(frozen=True)
class Look:
    """How a law is drawn: its colour, and its dashes where dashes do not tell groups apart."""

    colour: str
    dashes: Dashes = "-"


#: Fixed, so that a law looks the same in every figure; the dashes tell laws apart in greyscale.
LAW_LOOKS = {
    "mppt": Look("#D55E00", (0.0, (5.0, 1.4, 1.2, 1.4))),
    "deloaded-5": Look("#E69F00", (0.0, (3.0, 1.4))),
    "deloaded-10": Look("#CC79A7", (0.0, (7.0, 1.8))),
    "coordinated-linear": Look("#009E73", (0.0, (6.0, 1.3, 1.2, 1.3, 1.2, 1.3))),
    "coordinated-piecewise": Look("#0072B2"),
    "coordinated-undamped": Look("#56B4E9", (0.0, (1.2, 1.2))),
    "coordinated-tuned": Look("#000000", (0.0, (10.0, 2.0))),
    # Wine: of the palette only yellow is left.
    "coordinated-free": Look("#882255", (0.0, (2.5, 1.0, 2.5, 3.0))),
}
# Without those of the references of v1, so that an entry looks the same beside one of them and beside all.
_FREE_COLOURS = (*PALETTE[1:6], PALETTE[7])
_FREE_DASHES: tuple[Dashes, ...] = ("-", (0.0, (4.0, 1.5)), (0.0, (1.2, 1.2)), (0.0, (5.0, 1.4, 1.2, 1.4)))

#: Widths, sizes and fonts of print, for matplotlib.
_STYLE = Path(__file__).with_name("print.mplstyle")
# Of every file format that is written; a date would make every file a new one.
_METADATA: dict[str, dict[str, Any]] = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}


def law_looks(labels: Iterable[str]) -> dict[str, Look]:
    """Return the look of each label: a law's own one, what is left of palette and dashes for other labels."""
    looks = {name: LAW_LOOKS.get(name) for name in labels}
    taken = {look.colour for look in looks.values() if look is not None}
    free = [colour for colour in _FREE_COLOURS if colour not in taken] or _FREE_COLOURS
    others = map(Look, itertools.cycle(free), itertools.cycle(_FREE_DASHES))
    return {name: next(others) if look is None else look for name, look in looks.items()}


def _print_style() -> AbstractContextManager[None]:
    """Draw in the style of print inside the `with` block; the user's matplotlib settings have no effect."""
    import matplotlib.style

    return matplotlib.style.context(["default", _STYLE])


def printed(draw: "Callable[Parameters, Figure]") -> "Callable[Parameters, Figure]":
    """Decorate a function that draws a figure: it draws in the style of print and with a layout that stays."""

    @functools.wraps(draw)
    def drawn(*args: Parameters.args, **kwargs: Parameters.kwargs) -> "Figure":
        with _print_style():
            figure = draw(*args, **kwargs)
            # The second pass starts from the tick labels of the first. After it places are fixed, without the last
            # digits, which differ from run to run: each format and each repetition gets the same ones.
            layout = figure.get_layout_engine()
            if layout is not None:
                for _ in range(2):
                    layout.execute(figure)
            figure.set_layout_engine(None)
            for axes in figure.axes:
                box = axes.get_position(original=True)
                axes.set_position(box.from_extents(*box.get_points().ravel().round(12)))
        return figure

    return drawn


def new_figure(width_mm: float = SINGLE_COLUMN_MM, height_mm: float = 65.0) -> "Figure":
    """Return an empty figure of a printed size [mm] with constrained layout."""
    from matplotlib.figure import Figure

    size = width_mm / _MM_PER_INCH, height_mm / _MM_PER_INCH
    return Figure(figsize=size, facecolor="white", layout="constrained")


def figure_bytes(figure: "Figure", suffix: str) -> bytes:
    """Return a figure as a file, the same bytes on each run; a ValueError if the suffix is none of png, svg, pdf."""
    ending = suffix.lower().removeprefix(".")
    if ending not in _METADATA:
        raise ValueError(f"a figure is written as {', '.join(_METADATA)}, got {suffix!r}")
    picture = io.BytesIO()
    with _print_style():
        figure.savefig(picture, format=ending, dpi=_DPI, metadata=_METADATA[ending])
    return picture.getvalue()


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure into a file: .svg, .png or .pdf; errors as of :func:`figure_bytes`."""
    write_atomically(path, figure_bytes(figure, path.suffix))


def letter_panel(axes: "Axes", letter: str, text: str) -> None:
    """Write "(a) text" above the left end of a panel."""
    axes.set_title(f"({letter}) {text}", loc="left", pad=10.0)
