"""A pair of volumes in tiles: what all of them share, one tile, and what they make together.

The folder of the work holds what passes from one step to the next:

- ``plan.json``: what was asked for, and what was chosen once for all tiles.
- ``images_L.npy``: both images on the scale that is L levels coarser than their own, shape
  (2, depth, height, width); ``dead_L.npy``: where they carry no data, if there are defects.
- ``choice_L.json``: the weight of a scale that is solved in tiles.
- ``tile_L_N.npy``: the field on the region of tile N, on the finest scale with the correlation
  of the images and the standard deviations, px, as more components; ``tile_L_N.json``: what the
  images say of it.
- ``field_L.npy``: the whole field of a scale, in the unit of the grid.

No step holds more than some windows as large as a tile in memory.
"""

import json
import logging
import math
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from eofm import io
from eofm.analysis.boundary import parse_edge
from eofm.analysis.scene import region_of_interest
from eofm.analysis.summary import check_measures
from eofm.errors import InputError
from eofm.flow.estimate import best_start, largest_small
from eofm.flow.known import Known
from eofm.flow.problem import FINEST, Problem, nothing
from eofm.flow.tiles import (
    Choice,
    Scale,
    Tile,
    blend,
    carried,
    choose,
    common,
    counts_at,
    cut,
    probes,
    shape_of,
    solve,
    tiled_scales,
)
from eofm.grid import Array, Edge, Mask, faces
from eofm.imaging.greys import Greys
from eofm.imaging.splines import needed, resize_part
from eofm.settings import Estimation, Measures, Pair, Tiling

logger = logging.getLogger("eofm")

Window = tuple[slice, ...]
# What a pair may ask for that tiles cannot give, by its key, and what it is otherwise.
NONE = {"frames": None, "mask": None, "extent": None, "background": "none", "stiffness": False}
# Widths over which a field is smoothed that an overlap should hold.
WIDTHS = 2.5


@dataclass(frozen=True)
class Plan:
    """What all steps know.

    Attributes
    ----------
    files : tuple of str
        Images before and after compression.
    inputs : dict
        SHA-256 and mark of the files, by their places.
    settings : dict
        All that was asked for, by section.
    first, shape : tuple of int
        First voxel and size of the region of interest, in the order of the axes.
    least : float or None
        Value that stands for smaller ones in the logarithm; None where none is taken.
    edges : dict
        Motion of faces, px.
    sides, source : tuple of float, str
        Sides of a voxel, and who says so; None where nobody does.
    greys : Greys
    spreads : list
        Standard deviations of the images by level.
    """

    files: tuple[str, str]
    inputs: dict[str, tuple[str, list[int]]]
    settings: dict[str, dict[str, Any]]
    first: tuple[int, ...]
    shape: tuple[int, ...]
    least: float | None
    edges: dict[Edge, list[float]]
    sides: tuple[float, ...] | None
    source: str | None
    greys: Greys
    spreads: list[list[float]]

    def write(self, path: Path) -> None:
        """Write it as JSON."""
        io.write_json(path, asdict(self) | {"greys": self.greys.summary()})

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read what :meth:`write` wrote.

        Raises
        ------
        InputError
            If there is none.
        """
        if not path.is_file():
            raise InputError(f"{path.parent}: holds no plan; make it by eofm coarse first")
        said = json.loads(path.read_text())
        said |= {key: tuple(said[key]) for key in ("files", "first", "shape")}
        said["sides"] = said["sides"] and tuple(said["sides"])
        return cls(**said | {"greys": Greys.parse(said["greys"])})

    @cached_property
    def estimation(self) -> Estimation:
        """The settings of the estimate."""
        return Estimation.parse(self.settings["estimation"], "estimation")

    @cached_property
    def measures(self) -> Measures:
        """What is made of it."""
        keys = Measures.model_fields
        return Measures.parse({k: self.settings["pair"][k] for k in keys}, "pair")

    @cached_property
    def problem(self) -> Problem:
        """That of the whole volume."""
        n = len(self.shape)
        edges = {e: np.reshape(u, (n, *[1] * (n - 1))) for e, u in self.edges.items()}
        known = Known(edges=edges, pixel_size=self.sides or (1.0,) * n)
        return Problem.of(self.shape, self.estimation, known)

    @property
    def levels(self) -> int:
        """How many scales are solved in tiles."""
        return tiled_scales(self.counts(0), self.estimation.factor)

    def counts(self, level: int) -> tuple[int, ...]:
        """Numbers of tiles along the axes."""
        tiles = self.settings["tiling"]["tiles"][::-1]
        return counts_at(tiles, level, self.estimation.factor)

    @property
    def overlap(self) -> int:
        """Samples by which tiles reach into each other on all scales."""
        return int(self.settings["tiling"]["overlap"])

    def grid(self, level: int) -> tuple[int, ...]:
        """Shape of the scale that is so many levels coarser."""
        return self.problem.grids[-1 - level].shape

    def tiles(self, level: int) -> list[Tile]:
        """Those of a scale."""
        return cut(self.grid(level), self.counts(level), self.overlap)

    @property
    def most(self) -> int:
        """Voxels of the largest tile with its overlap."""
        return max(math.prod(shape_of(tile.region)) for tile in self.tiles(0))


class Work:
    """A folder of the work, its plan, and the arrays in it that are open."""

    def __init__(self, folder: Path, plan: Plan, stack: ExitStack) -> None:
        self.folder, self.plan, self.stack = folder, plan, stack
        self.stores: dict[str, io.Store] = {}
        for place, (_, mark) in plan.inputs.items():
            if not Path(place).exists() or list(io.mark(Path(place)))[:2] != mark[:2]:
                raise InputError(f"{place}: changed after eofm coarse; run it again")
        self.images = [io.open_stored(Path(name)) for name in plan.files]

    @classmethod
    def open(cls, folder: Path, stack: ExitStack) -> Self:
        """The one that :func:`coarse` has made; results name the same inputs."""
        plan = Plan.read(folder / "plan.json")
        work = cls(folder, plan, stack)
        if (made := io.Origin.current()) is not None:
            made.settings |= plan.settings
            for place, (digest, _) in plan.inputs.items():
                made.inputs[Path(place)] = digest, io.mark(Path(place))
        return work

    def store(self, name: str) -> io.Store:
        """An array, to be read."""
        if name not in self.stores:
            opened = io.open_store(self.folder / f"{name}.npy")
            self.stores[name] = self.stack.enter_context(opened)
        return self.stores[name]

    def new(self, name: str, shape: tuple[int, ...]) -> io.Store:
        """An array of zeros, to be written and read."""
        made = io.new_store(self.folder / f"{name}.npy", shape)
        self.stores[name] = self.stack.enter_context(made)
        return self.stores[name]

    def of_tile(self, level: int, number: int, window: Window) -> Array:
        """A window of what a tile has written: there may be more of them than files can be open."""
        with io.open_store(self.folder / f"tile_{level}_{number}.npy") as store:
            return store.read(window)

    def scratch(self, shape: tuple[int, ...]) -> io.Store:
        """An array of zeros that goes with this process."""
        return self.stack.enter_context(io.scratch_store(self.folder, shape))

    def raw(self, k: int, window: Window) -> Array:
        """Values of an image as they are compared, or their logarithm."""
        first, least = self.plan.first, self.plan.least
        at = tuple(slice(w.start + f, w.stop + f) for w, f in zip(window, first, strict=True))
        I = self.images[k].read(at)
        return I if least is None else np.log(np.maximum(I, I.dtype.type(least)))

    def dead(self, k: int, window: Window) -> Mask:
        """Where an image shows the detector."""
        found: Mask = self.store("dead_0").read((slice(k, k + 1), *window))[0] >= 0.5
        return found

    def read(self, level: int, k: int, window: Window) -> tuple[Array, Mask]:
        """A window of an image of a scale, and where it carries data."""
        if level == 0:
            return self.plan.greys.read(self.raw, self.dead, k, window, self.plan.shape)
        at = (slice(k, k + 1), *window)
        I = self.store(f"images_{level}").read(at)[0]
        if not any(self.plan.greys.levels):
            return I, np.ones(I.shape, dtype=bool)
        return I, self.store(f"dead_{level}").read(at)[0] < 0.5

    def scale(self, level: int) -> Scale:
        """The problem on a scale."""
        number = len(self.plan.problem.grids) - 1 - level
        read = partial(self.read, level)
        return Scale(self.plan.problem, number, read, self.plan.spreads[level])

    def start(self, level: int, window: Window) -> Array:
        """What the scale before gives in a window of this one."""
        field = self.store(f"field_{level + 1}")

        def read(part: Window) -> Array:
            return field.read((slice(0, len(self.plan.shape)), *part))

        return carried(read, self.plan.grid(level + 1), self.plan.grid(level), window)

    def choose(self, level: int, chosen: tuple[float, ...]) -> None:
        """Choose the weight of a scale for all of its tiles, and say where the overlap is short."""
        overlap = self.plan.overlap
        tiles = probes(self.plan.grid(level), overlap)
        made = choose(self.scale(level), tiles, partial(self.start, level), chosen)
        if level == 0 and WIDTHS * made.reach > overlap:
            logger.warning(
                f"the field is smoothed over {made.reach:.0f} px: tiles will agree better with an"
                f" overlap of {math.ceil(WIDTHS * made.reach)} px"
            )
        io.write_json(self.folder / f"choice_{level}.json", made._asdict())

    def blended(self, level: int, window: Window, components: slice) -> Array:
        """A window of what the tiles of a scale make together."""
        shape = self.plan.grid(level)
        field = np.zeros((components.stop - components.start, *shape_of(window)), np.float32)
        for number, tile in enumerate(self.plan.tiles(level)):
            both = common(window, tile.region)
            if both is not None:
                part = Tile(both, tile.region).inner
                u = self.of_tile(level, number, (components, *part))
                blend(field, window, tile, u, shape, self.plan.overlap)
        return field


def coarse(pair: Pair, estimation: Estimation, tiling: Tiling, folder: Path) -> str:
    """Do what tiles share: grey scale, coarse copies, the coarse scales, the first choice.

    Returns what comes next.

    Raises
    ------
    InputError
        In one line that begins with the key at fault.
    """
    plan = _planned(pair, estimation, tiling)
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


def _planned(pair: Pair, estimation: Estimation, tiling: Tiling) -> Plan:
    """What is known before any long work."""
    for key, value in NONE.items():
        if getattr(pair, key) != value:
            raise InputError(f"{key}: is not done in tiles; leave it out, or the tiles")
    if estimation.smoothness_of != "v" or estimation.warped_by != "u" or estimation.ends != "full":
        raise InputError("method: tiles want the preset, whose scales end at the voxels")
    if estimation.local_window is not None:
        raise InputError("local_window: is not done in tiles; the preset fits brightness itself")
    names = (str(pair.reference), str(pair.deformed))
    inputs = {}
    images = []
    for name in names:
        images.append(io.open_stored(Path(name)))
        place = Path(images[-1].name).resolve()
        with io.reading(place):
            pass
        made = io.Origin.current()
        digest = made.inputs[place][0] if made else io.checksum(place)
        inputs[str(place)] = digest, list(io.mark(place))
    if images[0].shape != images[1].shape:
        sizes = [" x ".join(map(str, image.shape)) for image in images]
        raise InputError(
            f"{names[1]}: has {sizes[1]} px but {names[0]} has {sizes[0]}; crop both to one size"
        )
    if len(images[0].shape) != 3:
        raise InputError("tiles: are of volumes; an image fits into memory, leave them out")
    first, shape = _region(pair, images[0].shape)
    named = {name: image.scan for name, image in zip(names, images, strict=True)}
    size = io.pixel_size(named, 3, pair.sides)
    edges = _edges(pair, shape, size.sides if size else None)
    estimation.check_widths(shape)
    check_measures(pair, shape, size.sides if size else (1.0,) * 3)
    settings = {"pair": pair, "estimation": estimation, "tiling": tiling}
    said = {key: section.model_dump(mode="json") for key, section in settings.items()}
    hollow = Greys((0.0, 1.0), (0.0, 1.0), (None, None))
    sides, source = (size.sides, size.source) if size else (None, None)
    plan = Plan(names, inputs, said, first, shape, None, edges, sides, source, hollow, [])
    grids = len(plan.problem.grids)
    if plan.levels >= grids:
        raise InputError(
            f"tiles: {math.prod(plan.counts(0))} are too many for the {grids} scales of a volume of"
            f" {' x '.join(map(str, shape))} px; use fewer"
        )
    for level in range(plan.levels):
        plan.tiles(level)
    return plan


def _region(pair: Pair, whole: tuple[int, ...]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """First voxel and size of the region of interest."""
    n = len(whole)
    roi = region_of_interest(pair, whole)
    return tuple(roi[:n][::-1]), tuple(roi[n:][::-1])


def _edges(
    pair: Pair, shape: tuple[int, ...], sides: tuple[float, ...] | None
) -> dict[Edge, list[float]]:
    """Motion of the faces that is stated."""
    states = {e: parse_edge(e, getattr(pair, e), shape, sides) for e in faces(len(shape))}
    return {
        edge: [float(v) for v in state.motion.ravel()]
        for edge, state in states.items()
        if state.motion is not None and not state.outside
    }


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


def read_choice(folder: Path, level: int) -> Choice:
    """What was chosen for the tiles of a scale.

    Raises
    ------
    InputError
        If it is not chosen yet.
    """
    path = folder / f"choice_{level}.json"
    if not path.is_file():
        raise InputError(
            f"{folder}: level {level} is not prepared yet; gather the tiles of level {level + 1}"
        )
    said = json.loads(path.read_text())
    overall = {name: tuple(values) for name, values in said["overall"].items()}
    return Choice(**said | {"chosen": tuple(said["chosen"]), "overall": overall})


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
