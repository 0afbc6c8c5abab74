"""The folder of volumes in tiles, and what passes in it from one step to the next.

- ``plan.json``: what was asked for, and what was chosen once for all tiles.
- ``images_L.npy``: both images on the scale that is L levels coarser than their own, shape
  (2, depth, height, width); ``dead_L.npy``: where they carry no data, if there are defects.
- ``choice_L.json``: the weight of a scale that is solved in tiles.
- ``tile_L_N.npy``: the field on the region of tile N, on the finest scale with the correlation
  of the images and the standard deviations, px, as more components; ``tile_L_N.json``: what the
  images say of it.
- ``field_L.npy``: the whole field of a scale, in the unit of the grid.
"""

import json
import logging
import math
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Self

import numpy as np

from eofm import io
from eofm.analysis.plan import Plan
from eofm.errors import InputError
from eofm.flow.scale import Choice, Scale, choose
from eofm.flow.tiles import Tile, blend, carried, common, probes, shape_of
from eofm.grid import Array, Mask

logger = logging.getLogger("eofm")

Window = tuple[slice, ...]
# Widths over which a field is smoothed that an overlap should hold.
WIDTHS = 2.5


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
