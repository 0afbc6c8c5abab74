"""Coarse to fine: grids that share corners, and images sampled on them."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import ceil

from tqdm import tqdm

from eofm.errors import InputError
from eofm.grid import Array, Grid
from eofm.imaging.splines import Spline

# Fewer samples than this along a side say nothing about a displacement.
SMALLEST = 4
# Fewer than this are not asked for where the number of scales is left open.
SMALL = 12


def pyramid(
    shape: tuple[int, int],
    scales: int | None,
    factor: float,
    spacing: tuple[float, float] = (1.0, 1.0),
    skipped: int = 0,
) -> list[Grid]:
    """Grids from coarse to fine that share the corners of the image.

    Distances are measured in the same unit on all of them, in which ``spacing`` is that of
    the finest grid, so that displacements, bubbles, sigma, alpha and beta keep their
    values from scale to scale. Without ``scales`` there are as many as leave 12 px. The finest
    ones that are ``skipped`` do not count, unless there is no other.

    Raises
    ------
    InputError
        If the image is too small for so many scales.
    """
    height, width = shape
    grids = [Grid(shape, spacing)]
    for scale in range(1, scales + skipped if scales else max(shape)):
        rows, columns = (ceil((n - 1) * factor) + 1 for n in grids[-1].shape)
        least = SMALL if scales is None else SMALLEST
        if min(rows, columns) < least or (rows, columns) == grids[-1].shape:
            if scales is None:
                break
            raise InputError(
                f"an image of {height} x {width} px is too small for {scales} scales;"
                f" use at most {scale - skipped} (scales) or a factor nearer 1"
            )
        coarser = (width - 1) / (columns - 1), (height - 1) / (rows - 1)
        h1, h2 = (h * c for h, c in zip(spacing, coarser, strict=True))
        grids.append(Grid((rows, columns), (h1, h2)))
    return (grids[skipped:] or grids)[::-1]


@contextmanager
def solving(grid: Grid, progress: bool) -> Iterator[Callable[[int, float], None]]:
    """A ``report`` for :func:`eofm.flow.multigrid.multigrid` that shows what takes long.

    Size of the grid, iteration and residual stand below the bar of the scales, after a second
    and if standard error is a terminal.
    """
    title = f"{grid.shape[0]} x {grid.shape[1]} px"
    hidden = None if progress else True
    with tqdm(desc=title, unit=" iterations", leave=False, delay=1, disable=hidden) as bar:

        def report(iteration: int, residual: float) -> None:
            bar.set_postfix_str(f"residual {residual:.0e}", refresh=False)
            bar.update(iteration - bar.n)

        yield report


def sampled(I: Array, grids: Sequence[Grid]) -> list[Array]:
    """The image on grids from coarse to fine."""
    spline = Spline(I)
    return [I if grid.shape == I.shape else spline.resize(grid.shape) for grid in grids]
