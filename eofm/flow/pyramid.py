"""Coarse to fine: grids that share corners, and images sampled on them."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import ceil, prod

from tqdm import tqdm

from eofm.errors import InputError
from eofm.grid import Array, Grid
from eofm.imaging.splines import Spline

# Fewer samples than this along a side say nothing about a displacement.
SMALLEST = 4
# Fewer than this are not asked for where the number of scales is left open. The depth of a volume,
# mostly its shortest side, stays as it is then, and so does a side of what is so many times longer.
SMALL, LONG = 12, 4
# Side of the image, or volume, on which starts are compared, samples.
SIDE = {2: 160, 3: 48}


def pyramid(
    shape: tuple[int, ...],
    scales: int | None,
    factor: float,
    spacing: tuple[float, ...] = (),
    skipped: int = 0,
) -> list[Grid]:
    """Grids from coarse to fine that share the corners of the image.

    Distances are measured in the same unit on all of them, in which ``spacing`` is that of
    the finest grid, so that displacements, bubbles, sigma, alpha and beta keep their
    values from scale to scale. Without ``scales`` there are as many as leave 12 px, and a side
    that has no more is kept where others are four times longer. The finest ones that are
    ``skipped`` do not count, unless there is no other.

    Raises
    ------
    InputError
        If the image is too small for so many scales.
    """
    if len(shape) == 3 and min(shape) < SMALLEST:
        raise InputError(f"a volume of {_size(shape)} is too thin; give {SMALLEST} slices at least")
    grids = [Grid(shape, spacing)]
    for scale in range(1, scales + skipped if scales else max(shape)):
        coarser = _coarser(grids[-1].shape, factor, scales is None)
        if coarser is None:
            if scales is None:
                break
            raise InputError(
                f"{'an image' if len(shape) == 2 else 'a volume'} of {_size(shape)} is too small"
                f" for {scales} scales;"
                f" use at most {scale - skipped} (scales) or a factor nearer 1"
            )
        sides = zip(grids[0].spacing, shape[::-1], coarser[::-1], strict=True)
        grids.append(Grid(coarser, tuple(h * ((n - 1) / (m - 1)) for h, n, m in sides)))
    return (grids[skipped:] or grids)[::-1]


def _coarser(shape: tuple[int, ...], factor: float, unasked: bool) -> tuple[int, ...] | None:
    """The next grid's shape, if there is one with at least some samples along each side."""
    least = SMALL if unasked else SMALLEST
    coarser = [ceil((n - 1) * factor) + 1 for n in shape]
    for axis, (n, m) in enumerate(zip(shape, coarser, strict=True)):
        depth = len(shape) == 3 and axis == 0
        short = unasked and SMALL <= n < max(shape) / LONG
        if m < least and (depth or short):
            coarser[axis] = n
    too_small = any(m < least and m < n for n, m in zip(shape, coarser, strict=True))
    return None if too_small or tuple(coarser) == shape else tuple(coarser)


def largest_small(grids: Sequence[Grid]) -> int:
    """Number of the largest grid of up to ``SIDE``^ndim samples, or of the coarsest."""
    ndim = grids[0].ndim
    return max(sum(prod(grid.shape) <= SIDE[ndim] ** ndim for grid in grids) - 1, 0)


def _size(shape: tuple[int, ...]) -> str:
    return f"{' x '.join(map(str, shape))} px"


@contextmanager
def solving(grid: Grid, progress: bool) -> Iterator[Callable[[int, float], None]]:
    """A ``report`` for :func:`eofm.flow.multigrid.multigrid` that shows what takes long.

    Size of the grid, iteration and residual stand below the bar of the scales, after a second
    and if standard error is a terminal.
    """
    title = _size(grid.shape)
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
