"""What is known of a pair of volumes in tiles before any long work, and kept for all its steps."""

import json
import math
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from eofm import io
from eofm.analysis.boundary import parse_edge
from eofm.analysis.scene import region_of_interest
from eofm.analysis.summary import check_measures
from eofm.errors import InputError
from eofm.flow.known import Known
from eofm.flow.problem import Problem
from eofm.flow.tiles import Tile, counts_at, cut, shape_of, tiled_scales
from eofm.grid import Edge, faces
from eofm.imaging.greys import Greys
from eofm.settings import Estimation, Measures, Pair, Tiling

# What a pair may ask for that tiles cannot give, by its key, and what it is otherwise.
NONE = {"frames": None, "mask": None, "extent": None, "background": "none", "stiffness": False}


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
    edges: dict[Edge, list[float | None]]
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
        stated = {e: np.array(u, dtype=float) for e, u in self.edges.items()}
        edges = {e: u.reshape(n, *[1] * (n - 1)) for e, u in stated.items()}
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


def planned(pair: Pair, estimation: Estimation, tiling: Tiling) -> Plan:
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
) -> dict[Edge, list[float | None]]:
    """Motion of the faces that is stated; None where a component is free."""
    states = {e: parse_edge(e, getattr(pair, e), shape, sides) for e in faces(len(shape))}
    return {
        edge: [float(v) if np.isfinite(v) else None for v in state.motion.ravel()]
        for edge, state in states.items()
        if state.motion is not None and not state.outside
    }
