"""The steps of a pair of volumes in tiles: what all of them share, one tile, and their field.

No step holds more than some windows as large as a tile in memory.
"""

import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from eofm import io
from eofm.analysis.plan import Plan, planned
from eofm.analysis.work import Work, read_choice
from eofm.errors import InputError
from eofm.flow.coarse import best_start
from eofm.flow.images import FINEST
from eofm.flow.problem import nothing
from eofm.flow.pyramid import largest_small
from eofm.flow.scale import solve
from eofm.flow.tiles import shape_of
from eofm.imaging.greys import Greys
from eofm.imaging.splines import needed, resize_part
from eofm.settings import Estimation, Pair, Tiling


def coarse(pair: Pair, estimation: Estimation, tiling: Tiling, folder: Path) -> str:
    """Do what tiles share: grey scale, coarse copies, the coarse scales, the first choice.

    Returns what comes next.

    Raises
    ------
    InputError
        In one line that begins with the key at fault.
    """
    plan = planned(pair, estimation, tiling)
    folder.mkdir(parents=True, exist_ok=True)
    with io.together(), ExitStack() as stack:
        work = Work(folder, plan, stack)
        if pair.intensity == "log":
            plan = replace(plan, least=_least_positive(work))
            work.plan = plan
        limits = estimation.limits
        greys = Greys.of(work.raw, plan.shape, plan.most, estimation.robust, limits)
        work.plan = plan = replace(plan, greys=greys)
        if any(greys.levels):
            _mark_dead(work)
        plan.spreads.extend(_copies(work))
        chosen = _solve_coarse(work)
        work.choose(plan.levels - 1, chosen)
        plan.write(folder / "plan.json")
    return _next(plan, plan.levels - 1)


def _least_positive(work: Work) -> float:
    """What stands for values that have no logarithm."""
    least, plan = math.inf, work.plan
    for k in (0, 1):
        for window in io.windows(plan.shape, plan.most):
            I = work.raw(k, window)
            if I.min() < 0:
                raise InputError("intensity: log of negative values; use linear")
            least = min(least, float(I[I > 0].min(initial=np.inf)))
    if not math.isfinite(least):
        raise InputError("intensity: log of an image that is zero everywhere")
    return least


def _mark_dead(work: Work) -> None:
    """Write where the images show the detector: once, so that tiles do not differ about it."""
    plan = work.plan
    store = work.new("dead_0", (2, *plan.shape))
    for k in (0, 1):
        for window in io.windows(plan.shape, plan.most):
            dead = plan.greys.dead(work.raw, k, window, plan.shape)
            store.write((slice(k, k + 1), *window), dead[None])


def _copies(work: Work) -> list[list[float]]:
    """Write coarser copies of the images, each from the one before; return standard deviations.

    Those of the volume itself are not asked for.
    """
    plan, masked = work.plan, any(work.plan.greys.levels)
    spreads = [[1.0, 1.0]]
    for level in range(1, len(plan.problem.grids)):
        old, new = plan.grid(level - 1), plan.grid(level)
        images = work.new(f"images_{level}", (2, *new))
        dead = work.new(f"dead_{level}", (2, *new)) if masked else None
        spreads.append([])
        for k in (0, 1):
            total, squares = 0.0, 0.0
            # A window, its margins and their coefficients are as large as a tile.
            for window in io.windows(new, max(plan.most // 16, 1)):
                part = needed(old, new, window)
                I, live = work.read(level - 1, k, part)
                J = resize_part(I, part, old, new, window)
                images.write((slice(k, k + 1), *window), J[None])
                total += float(J.sum(dtype=np.float64))
                squares += float((J.astype(np.float64) ** 2).sum())
                if dead is not None:
                    share = resize_part((~live).astype(np.float32), part, old, new, window)
                    dead.write((slice(k, k + 1), *window), share[None])
            count = math.prod(new)
            variance = max(squares / count - (total / count) ** 2, 0.0)
            spreads[-1].append(math.sqrt(variance))
    return spreads


def _solve_coarse(work: Work) -> tuple[float, ...]:
    """Solve the scales that are as small as a tile, whole; return the weights they have chosen."""
    plan = work.plan
    problem, count = plan.problem, len(plan.problem.grids) - plan.levels
    pairs = [
        work.scale(len(problem.grids) - 1 - number).pair(
            tuple(slice(0, n) for n in grid.shape), nothing(grid.shape)
        )
        for number, grid in enumerate(problem.grids[:count])
    ]
    compared = min(largest_small(problem.grids), len(problem.grids) - 1 - FINEST, count - 1)
    u, chosen = problem.u_bg, tuple[float, ...]()
    for number, pair in enumerate(pairs):
        better = problem.level(number, pair, u).improve(chosen, False)
        u, chosen = better.u, better.chosen
        if plan.estimation.robust and number == compared:
            u = best_start(problem, number, pairs, u)
    field = work.new(f"field_{plan.levels}", u.shape)
    field.write(tuple(slice(0, n) for n in u.shape), u)
    return chosen


def tile(folder: Path, level: int, number: int) -> None:
    """Estimate one tile of a scale.

    Raises
    ------
    InputError
        If there is no such tile, or what it starts from is missing.
    """
    with io.together(), ExitStack() as stack:
        work = Work.open(folder, stack)
        _check_level(work, level)
        tiles = work.plan.tiles(level)
        if number >= len(tiles):
            raise InputError(f"number: there are tiles 0 to {len(tiles) - 1} on level {level}")
        choice, part = read_choice(folder, level), tiles[number]
        start = work.start(level, part.region)
        # Error bars are of the finest scale, as what the images say is.
        draws = 0 if level else work.plan.measures.error_bars
        found = solve(work.scale(level), part, start, choice, draws, number)
        values = [found.u]
        if level == 0:
            seen = np.full((1, *found.u.shape[1:]), np.nan, np.float32)
            seen[0][part.inner] = found.trust.map
            values += [seen] if found.deviation is None else [seen, found.deviation]
        u = np.concatenate(values)
        store = work.new(f"tile_{level}_{number}", u.shape)
        store.write(tuple(slice(0, n) for n in u.shape), u)
        io.write_json(folder / f"tile_{level}_{number}.json", found.trust.summary())


def _next(plan: Plan, level: int) -> str:
    """What to do with a level that is prepared."""
    tiles = plan.tiles(level)
    size = " x ".join(map(str, shape_of(tiles[0].region)[::-1]))
    return f"level {level} is ready: tiles 0 to {len(tiles) - 1}, of {size} px, then gather"


def gather(folder: Path, level: int) -> str:
    """Make the field of a scale from its tiles, and choose the weight of the next.

    Returns what comes next.

    Raises
    ------
    InputError
        If a tile is missing.
    """
    with io.together(), ExitStack() as stack:
        work = Work.open(folder, stack)
        _check_level(work, level)
        shape = work.plan.grid(level)
        write_field(work, level, work.new(f"field_{level}", (len(work.plan.shape), *shape)))
        work.choose(level - 1, read_choice(folder, level).chosen)
    return _next(work.plan, level - 1)


def write_field(work: Work, level: int, field: io.Store) -> io.Store:
    """Write the field of a scale from its tiles into an array, which is returned."""
    shape = work.plan.grid(level)
    n, missing = len(shape), []
    for number in range(len(work.plan.tiles(level))):
        if not (work.folder / f"tile_{level}_{number}.npy").is_file():
            missing.append(str(number))
    if missing:
        raise InputError(
            f"{work.folder}: tiles {', '.join(missing)} of level {level} are missing; eofm tile"
            " makes them"
        )
    for window in io.windows(shape, max(work.plan.most // 4, 1)):
        u = work.blended(level, window, slice(0, n))
        field.write((slice(0, n), *window), u)
    return field


def _check_level(work: Work, level: int) -> None:
    if level >= work.plan.levels:
        raise InputError(
            f"level: only 0 to {work.plan.levels - 1} are in tiles; eofm coarse has solved the rest"
        )
