"""The results of a volume in tiles as files and figures, made window by window."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eofm import io
from eofm.analysis import findings, page, summary
from eofm.analysis.findings import SHORT
from eofm.analysis.sections import Sections, middle
from eofm.analysis.step import doubted
from eofm.analysis.strain import strain
from eofm.analysis.tensors import invariants, labels
from eofm.analysis.tiles import write_field
from eofm.analysis.work import Work, read_choice
from eofm.flow.tiles import Tile, common, shape_of
from eofm.flow.trust import Trust, pooled
from eofm.grid import Array, componentwise, geometric_mean, precision
from eofm.imaging.greys import grown
from eofm.settings import Figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Window = tuple[slice, ...]
# Voxels that stand for all in means and percentiles of strain.
ENOUGH = 500_000
# Files of figures by what `figures` says.
KINDS = {"none": (), "png": ("png",), "all": ("png", "pdf")}
FIGURES = ("pair", "displacement", "strain", "trust")


class Gathered:
    """The gathered arrays, read as windows."""

    def __init__(self, work: Work, field: io.Store) -> None:
        self.work, self.plan, self.field = work, work.plan, field
        self.shape, self.n = work.plan.shape, len(work.plan.shape)
        self.sides = work.plan.sides or (1.0,) * self.n
        self.px = componentwise(work.plan.problem.grids[-1].spacing, self.n)

    def u(self, window: Window) -> Array:
        """Displacement, px."""
        found: Array = self.field.read((slice(0, self.n), *window)) / self.px
        return found

    def deviation(self, window: Window) -> Array:
        """Standard deviation of the displacement, px: errors of tiles are alike where they meet."""
        return self.work.blended(0, window, slice(self.n + 1, 2 * self.n + 1))

    @property
    def bars(self) -> bool:
        """Whether the tiles have standard deviations."""
        return self.plan.measures.error_bars > 0

    def slices(self, read: Any) -> Iterator[Array]:
        """What ``read`` gives of each slice, without that axis."""
        for z in range(self.shape[0]):
            window = (slice(z, z + 1), *(slice(0, n) for n in self.shape[1:]))
            values = read(window)
            yield values.reshape(*values.shape[:-3], *self.shape[1:])

    def sections(self, read: Any, component: int | None = None) -> Sections:
        """The three sections through the middle."""
        whole, at = tuple(slice(0, n) for n in self.shape), middle(self.shape)
        cuts = []
        for axis, k in enumerate(at):
            window = tuple(slice(k, k + 1) if a == axis else s for a, s in enumerate(whole))
            values = read(window)
            values = values if component is None else values[component]
            cuts.append(values.reshape([m for a, m in enumerate(values.shape) if a != axis]))
        return Sections(self.shape, cuts[0], cuts[2], cuts[1])

    def times(self, read: Any, factor: Array | float) -> Any:
        """The same in another unit."""
        return lambda window: read(window) * factor

    def strain_of_all(self) -> io.Store:
        """Compute the strain, cube by cube."""
        measures = self.plan.measures
        e = self.work.scratch((self.n * (self.n + 1) // 2, *self.shape))
        reach = math.ceil(4 * self.window / min(self.sides)) + 1
        for part in io.windows(self.shape, max(self.plan.most // 4, 1)):
            around, inner = grown(part, reach, self.shape)
            values = strain(self.u(around), self.sides, self.window, measures.strain_measure)
            e.write((slice(0, len(values)), *part), values[:, *inner])
        return e

    @property
    def window(self) -> float:
        """Window of the strain, um."""
        return self.plan.measures.strain_window or 3 * geometric_mean(self.sides)

    def trust(self, window: Window) -> Array:
        """Correlation of the images after the motion."""
        found: Array = np.full(shape_of(window), np.nan, precision(self.n))
        for number, tile in enumerate(self.plan.tiles(0)):
            both = common(window, tile.core)
            if both is not None:
                at, here = Tile(both, tile.region).inner, Tile(both, window).inner
                map_of_tile = (slice(self.n, self.n + 1), *at)
                found[here] = self.work.of_tile(0, number, map_of_tile)[0]
        return found


def write_gathered(work: Path, folder: Path) -> Trust:
    """Make the field of the tiles of the finest scale, and write all results into a folder.

    ``displacement.tif`` (px), ``displacement_um.tif`` if the size of a voxel is known,
    ``deviation.tif`` if error bars are wanted, ``strain.tif``, ``strain_invariants.tif``,
    ``trust.tif``, ``results.vti`` (the same for ParaView), ``summary.json``, ``provenance.json``,
    ``report.html``, and the figures ``pair``, ``displacement``, ``strain`` and ``trust``: three
    sections through the middle.

    Raises
    ------
    InputError
        If a tile is missing.
    """
    with io.together(), ExitStack() as stack:
        opened = Work.open(work, stack)
        shape = (len(opened.plan.shape), *opened.plan.shape)
        results = Gathered(opened, write_field(opened, 0, opened.scratch(shape)))
        folder.mkdir(parents=True, exist_ok=True)
        e = results.strain_of_all()
        _write_fields(results, e, folder)
        _write_vti(results, e, folder)
        said, trust = _summary(results, e, _trust(results))
        kinds = KINDS[opened.plan.settings["pair"]["figures"]]
        for name in FIGURES:
            for kind in KINDS["all"]:
                io.remove(folder / f"{name}.{kind}")
        if kinds:
            from eofm.analysis import figures

            settings = _figure_settings(results)
            for name, figure in draw(results, e, said, settings).items():
                paths = [folder / f"{name}.{kind}" for kind in kinds]
                figures.save(figure, paths, settings)
        made = io.Origin.current() or io.Origin("gather", {})
        with io.replacing(folder / "report.html") as temporary:
            temporary.write_text(_page(folder.resolve().name, said, kinds, made), encoding="utf-8")
        io.write_json(folder / "provenance.json", made.record() | {"run": made.run()})
        io.write_json(folder / "summary.json", said | {"provenance": made.record()})
    return trust


def _trust(results: Gathered) -> Trust:
    """What the images say of all tiles."""
    parts, voxels = [], []
    for number, tile in enumerate(results.plan.tiles(0)):
        parts.append(json.loads((results.work.folder / f"tile_0_{number}.json").read_text()))
        voxels.append(math.prod(shape_of(tile.core)))
    return pooled(parts, voxels)


def _write_fields(results: Gathered, e: io.Store, folder: Path) -> None:
    n, (depth, *plane), sides = results.n, results.shape, results.plan.sides
    names = ("u1 lateral", "u2 axial", "u3 elevational")[:n]

    def write(name: str, read: Any, said: Sequence[str]) -> None:
        shape = (depth, len(said), *plane)
        io.write_slices(folder / name, results.slices(read), shape, list(said), sides)

    write("displacement.tif", results.u, [f"{name} [px]" for name in names])
    for name in ("displacement_um.tif", "deviation.tif"):
        io.remove(folder / name)
    if sides is not None:
        um = results.times(results.u, componentwise(sides, n))
        write("displacement_um.tif", um, [f"{name} [um]" for name in names])
    if results.bars:
        of = [f"deviation of {name} [px]" for name in names]
        write("deviation.tif", results.deviation, of)
    write("strain.tif", partial(_values, e), labels(n))
    named = list(_invariants(results, e, tuple(slice(0, 1) for _ in results.shape)))
    derived = partial(_invariants, results, e)
    write("strain_invariants.tif", lambda w: np.stack(list(derived(w).values())), named)
    slices = results.slices(results.trust)
    io.write_slices(folder / "trust.tif", slices, results.shape, None, sides)


def _values(e: io.Store, window: Window) -> Array:
    """A window of all components."""
    found: Array = e.read((slice(0, e.shape[0]), *window))
    return found


def _invariants(results: Gathered, e: io.Store, window: Window) -> dict[str, Array]:
    """What does not depend on the axes of the strain."""
    return invariants(_values(e, window), results.plan.measures.strain_measure)


def _write_vti(results: Gathered, e: io.Store, folder: Path) -> None:
    """All fields on the first volume, lengths in the unit of its sides, which warping asks for."""
    n, plan = results.n, results.plan
    unit = "px" if plan.sides is None else "um"
    side = componentwise(results.sides, n)
    reads: dict[str, tuple[int, Any]] = {
        "first frame": (1, lambda w: results.work.read(0, 0, w)[0]),
        f"displacement [{unit}]": (n, results.times(results.u, side)),
    }
    if results.bars:
        bars = results.times(results.deviation, side)
        reads[f"standard deviation [{unit}]"] = (n, bars)
    reads["strain"] = (e.shape[0], partial(_values, e))
    for name in _invariants(results, e, tuple(slice(0, 1) for _ in results.shape)):
        reads[name] = (1, lambda w, name=name: _invariants(results, e, w)[name])
    reads["match of the images"] = (1, results.trust)
    fields = {name: (count, results.slices(read)) for name, (count, read) in reads.items()}
    strains = {"strain": labels(n)}
    io.write_vti_slices(folder / "results.vti", fields, results.shape, results.sides, strains)


def _summary(results: Gathered, e: io.Store, trust: Trust) -> tuple[dict[str, Any], Trust]:
    """What a reader wants to know first, named as in the summary of any sample; the verdict."""
    plan, n = results.plan, results.n
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    step = max(1, math.ceil((math.prod(results.shape) / ENOUGH) ** (1 / n)))
    some, bars = [], []
    for part in io.windows(results.shape, max(plan.most // 4, 1)):
        u = results.u(part).reshape(n, -1)
        low, high = np.minimum(low, u.min(axis=1)), np.maximum(high, u.max(axis=1))
        # Every so manieth voxel of the whole, whatever the windows are.
        at = tuple(slice(-w.start % step, None, step) for w in part)
        values = e.read((slice(0, e.shape[0]), *part))[:, *at]
        some.append(values.reshape(len(values), -1))
        if results.bars:
            bars.append(results.deviation(part)[:, *at].reshape(n, -1))
    sampled = np.concatenate(some, axis=1)[:, :, None, None]
    live = np.zeros(sampled.shape[1:], dtype=bool)
    found: dict[str, Any] = {
        "images": list(plan.files),
        "size_px": list(results.shape[::-1]),
        "pixel_size_um": list(results.sides),
        "pixel_size_from": plan.source,
        "steps": 1,
        "tiles": list(plan.counts(0)[::-1]),
        "overlap_px": plan.overlap,
        "alpha": [read_choice(results.work.folder, 0).alpha],
    }
    for i, side in enumerate(results.sides):
        found[f"u{i + 1}_range_px"] = [float(low[i]), float(high[i])]
        found[f"u{i + 1}_range_um"] = [float(side * low[i]), float(side * high[i])]
    found["largest_motion_px"] = [float(max(-a, b, 0)) for a, b in zip(low, high, strict=True)]
    found |= summary.of_strain(sampled, plan.measures, results.window, live)
    if results.bars:
        deviation = np.concatenate(bars, axis=1)
        found["deviation_median_px"] = [float(np.median(d)) for d in deviation]
        trust = doubted(trust, float(np.median(summary.length(deviation))))
    return found | {"trust": [trust.summary()]}, trust


def _figure_settings(results: Gathered) -> Figures:
    unit: Any = "px" if results.plan.sides is None else "um"
    return Figures(pixel_size=results.sides, unit=unit)


def draw(
    results: Gathered, e: io.Store, said: Mapping[str, Any], settings: Figures
) -> "dict[str, Figure]":
    """The figures by name, of three sections."""
    from eofm.analysis.figures import MAPS, NAMES, sections
    from eofm.analysis.panels import Look, unit_name
    from eofm.analysis.tensors import pairs

    n, unit = results.n, unit_name(settings)
    factors = results.sides if settings.unit == "um" else (1.0,) * n
    images = [results.sections(lambda w, k=k: results.work.read(0, k, w)[0]) for k in (0, 1)]
    top = float(np.percentile(np.concatenate([s.values() for s in images]), 99.9))
    grey = Look("gray", (0.0, max(top, 1e-6)))
    moved = []
    for i in range(n):
        low, high = (factors[i] * v for v in said[f"u{i + 1}_range_px"])
        limits = (low, high) if i == 1 else (-max(-low, high), max(-low, high))
        limits = limits if limits[1] > limits[0] else (limits[0] - 0.5, limits[0] + 0.5)
        part = results.sections(results.u, i).times(factors[i])
        moved.append((f"{NAMES[i]} displacement $u_{i + 1}$", part, Look(MAPS[i], limits, unit)))
    rows = [moved]
    if results.bars:
        rows.append([])
        for i in range(n):
            part = results.sections(results.deviation, i).times(factors[i])
            top = max(float(np.percentile(part.values(), 99.5)), SHORT * factors[i])
            look = Look("magma_r", (0.0, top), unit)
            rows[1].append((f"error bar of $u_{i + 1}$", part, look))
    strains = []
    for k, (i, j) in enumerate(pairs(n)):
        name = f"{NAMES[i]} strain" if i == j else "shear strain"
        part = results.sections(lambda w, k=k: e.read((slice(k, k + 1), *w))[0]).times(100.0)
        largest = max(float(np.nanpercentile(np.abs(part.values()), 99)), 1e-6)
        look = Look("RdBu_r", (-largest, largest), "%")
        strains.append((f"{name} $e_{{{i + 1}{j + 1}}}$", part, look))
    match = results.sections(results.trust)
    title = f"correlation after the motion: {findings.verdict(dict(said))}"
    titles = ("before compression", "after compression")
    return {
        "pair": sections([list(zip(titles, images, [grey] * 2, strict=True))], settings),
        "displacement": sections(rows, settings),
        "strain": sections([strains[k : k + 3] for k in range(0, len(strains), 3)], settings),
        "trust": sections([[(title, match, Look("cividis", (0, 1)))]], settings),
    }


def _page(title: str, said: dict[str, Any], kinds: tuple[str, ...], made: io.Origin) -> str:
    """The page of the whole, but that its pictures are the figures, which lie beside it."""
    size = " x ".join(str(n) for n in said["size_px"])
    tiles = " x ".join(str(n) for n in said["tiles"])
    shown = [f'<section><img src="{name}.png" alt="{name}"></section>' for name in FIGURES]
    return page.render(
        title,
        said,
        f"{size} px in {tiles} tiles; sections through the middle",
        list(findings.trusted(said)),
        shown if "png" in kinds else [],
        f"Made by eofm {made.record()['eofm']}, step {made.step}.",
        tuple(said["size_px"][::-1]),
    )
