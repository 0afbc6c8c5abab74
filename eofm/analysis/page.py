"""``report.html``: results that explain themselves on one page, which needs no network.

Pictures stand in the page as PNG without letters; titles, colour bars and sentences are text,
which a reader may enlarge, copy, and read on a dark background.
"""

from collections.abc import Iterator, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np

from eofm.analysis import findings, pictures
from eofm.analysis.analyse import Analysis
from eofm.analysis.findings import ASTRAY, NAMES, SHORT, Finding, Units
from eofm.analysis.summary import HELD, held
from eofm.analysis.tensors import invariants, labels
from eofm.grid import Array

TEMPLATE = "page.html"
# What stands above the findings, by the level of the first one.
HEADINGS = {"doubt": "What to doubt", "note": "What to know", "good": "Why to trust it"}


def page(results: Analysis, title: str, images: Sequence[str] = (), made: str = "") -> str:
    """The page of a pair or sequence.

    Parameters
    ----------
    results : Analysis
    title : str
        Name of the sample.
    images : sequence of str
        Names of the images.
    made : str
        By which version, in which step.
    """
    units, summary = Units(results.summary), results.summary
    size = " x ".join(str(n) for n in summary["size_px"])
    lengths = " x ".join(
        f"{n * units.factor(i):.4g}" for i, n in enumerate(results.first.shape[::-1])
    )
    subtitle = f"{size} px" + (f", {lengths} µm" if units.name != "px" else "")
    subtitle += ", lateral to the right, axial downwards"
    if results.first.ndim == 3:
        subtitle += "; sections through the middle: from in front, from the side, from above"
    named = ", ".join(escape(name) for name in images)
    sections = (_pair, _displacement, _strain, _trust, _stiffness, _table)
    maker = Maker(results, units)
    return render(
        title,
        summary,
        f"{named + ': ' if named else ''}{subtitle}",
        findings.doubts(summary),
        [part for section in sections for part in section(maker)],
        made,
        results.first.shape,
    )


def render(
    title: str,
    summary: dict[str, Any],
    subtitle: str,
    doubts: Sequence[Finding],
    sections: Sequence[str],
    made: str,
    shape: tuple[int, ...],
) -> str:
    """A page of what stands in a summary, the first of some ``doubts`` first, and of sections."""
    return Template(_template()).substitute(
        title=escape(title),
        kind="volume" if len(shape) == 3 else "image",
        # Deep pictures stand in narrow columns.
        least="20rem" if shape[-1] >= shape[-2] else "13rem",
        verdict=findings.verdict(summary),
        subtitle=subtitle,
        found="".join(f"<li>{escape(text)}</li>" for text in findings.found(summary)),
        heading=HEADINGS[doubts[0].level],
        doubts="".join(map(_finding, doubts)),
        sections="\n".join(sections),
        footer=escape(made),
    )


class Maker:
    """Results, and maps of them."""

    def __init__(self, results: Analysis, units: Units) -> None:
        self.results, self.units = results, units
        self.size = results.pixel_size

    def figure(
        self,
        title: str,
        values: Array,
        colours: str,
        limits: tuple[float, float],
        unit: str = "",
        said: Sequence[str] = (),
        about: str = "",
    ) -> str:
        """A map with its title and colour bar; empty in dead zones."""
        shown = np.where(self.results.dead, np.nan, values)
        # A range of nothing has no colours.
        low, high = limits if limits[1] > limits[0] else (limits[0] - 0.5, limits[0] + 0.5)
        address, (width, height) = pictures.png(shown, (low, high), colours, self.size)
        ends = said or [f"{value:.3g} {unit}" for value in (low, (low + high) / 2, high)]
        bar = "".join(f"<span>{escape(end)}</span>" for end in ends)
        about = f" <small>{escape(about)}</small>" if about else ""
        return (
            f"<figure><figcaption>{escape(title)}{about}</figcaption>"
            f'<div class="frame" style="aspect-ratio: {width:.6g} / {height:.6g}">'
            f'<img src="{address}" alt="{escape(title)}"></div>'
            f'<div class="bar"><i style="background: {pictures.gradient(colours)}"></i>'
            f"{bar}</div></figure>"
        )

    def live(self, values: Array) -> Array:
        """Values outside of dead zones."""
        found: Array = values[~self.results.dead & np.isfinite(values)]
        return found if found.size else np.zeros(1)

    def largest(self, values: Array, percent: float = 99) -> float:
        """A percentile of the size, of what is not dead."""
        return max(float(np.percentile(np.abs(self.live(values)), percent)), 1e-6)


def _pair(maker: Maker) -> Iterator[str]:
    results, count = maker.results, len(maker.results.steps)
    low, high = np.percentile([results.first, results.last], [0, 99.9])
    limits = float(low), max(float(high), float(low) + 1e-12)
    (before, size), (after, _) = (
        pictures.png(I, limits, "gray", maker.size) for I in (results.first, results.last)
    )
    names = ("before", "after") if count == 1 else ("first frame", "last frame")
    arrows, switch, about = "", "", ""
    if results.first.ndim == 2:
        path, factor = pictures.motion(results.steps[0].bubbles, results.first.shape)
        height, width = results.first.shape
        arrows = (
            f'<svg viewBox="0 0 {width} {height}" preserveAspectRatio="none">'
            f'<path d="{path}"/></svg>'
        )
        switch = '<input type="checkbox" id="bubbles" checked><label for="bubbles"> bubbles</label>'
        first = "" if count == 1 else " of the first step"
        about = f"Arrows show the motion of bubbles{first}"
        about += f", enlarged {factor} times. " if factor > 1 else ". "
    yield (
        f'<section class="pair"><h2>The images</h2><p>{about}Click on the picture, or press'
        " <kbd>b</kbd>, to see the other one.</p>"
        f'<input type="checkbox" id="flip"><label for="flip"> {names[1]}</label> {switch}'
        f'<div class="said"><span class="said-before">{names[0]}</span>'
        f'<span class="said-after">{names[1]}</span></div>'
        f'<label for="flip" class="frame" style="aspect-ratio: {size[0]:.6g} / {size[1]:.6g}">'
        f'<img class="before pixels" src="{before}" alt="{names[0]}">'
        f'<img class="after pixels" src="{after}" alt="{names[1]}">{arrows}</label></section>'
    )


def _displacement(maker: Maker) -> Iterator[str]:
    results, unit = maker.results, maker.units.name
    count = len(results.steps)
    maps = []
    for i, component in enumerate(results.u):
        factor = maker.units.factor(i)
        values = factor * component
        live = maker.live(values)
        low, high = float(live.min()), float(live.max())
        if i != 1:
            low, high = -max(-low, high), max(-low, high)
        colours = "viridis" if i == 1 else "RdBu_r"
        maps.append(maker.figure(f"{NAMES[i]} u{i + 1}", values, colours, (low, high), unit))
        if results.deviation is not None:
            bars = factor * results.deviation[i]
            top = max(maker.largest(bars, 99.5), SHORT * factor)
            title = f"error bar of u{i + 1}"
            about = "one standard deviation"
            maps.append(maker.figure(title, bars, "magma_r", (0, top), unit, about=about))
    whole = f"From the first frame to the last, the sum of {count} steps. " if count > 1 else ""
    yield _section(
        "Displacement",
        whole + "Of what was at a place before: to the right and downwards are positive.",
        maps,
        wide=True,
    )


def _strain(maker: Maker) -> Iterator[str]:
    results, measure = maker.results, maker.results.summary["strain_measure"]
    n = results.first.ndim
    derived = invariants(results.strain, measure)
    shown = dict(zip(labels(n), 100 * results.strain, strict=True))
    shown |= {name: 100 * derived[name] for name in list(derived)[-2:]}
    # One scale for all: what is next to nothing beside the others looks so.
    top = max(maker.largest(values) for values in shown.values())
    maps = []
    for name, values in shown.items():
        one_way = name == "maximum shear"
        limits, colours = ((0.0, top), "magma_r") if one_way else ((-top, top), "RdBu_r")
        maps.append(maker.figure(name, values, colours, limits, "%"))
    window = results.summary["strain_window_um"]
    yield _section(
        "Strain",
        f"Measure: {measure}. Slopes of local fits under a Gaussian of {window:.3g}"
        f" {maker.units.name}: finer detail is noise. Compression is negative.",
        maps,
    )


def _trust(maker: Maker) -> Iterator[str]:
    results, step = maker.results, maker.results.steps[0]
    first = "" if len(results.steps) == 1 else ", first step"
    side = maker.units.factor()
    back, left = side * step.inconsistency, results.residual
    most = maker.largest(left)
    # The whole range in px is shown while nothing is far off, so that good looks good.
    worst = max(side * ASTRAY, maker.largest(back))
    maps = [
        maker.figure(
            "match of the images", results.trust.map, "cividis", (0, 1), about="correlation"
        ),
        maker.figure(
            "what decides",
            shares(results),
            "share",
            (0, 1),
            said=("filled in", "mixed", "images"),
            about="share of the images in the estimate",
        ),
        maker.figure(f"there and back{first}", back, "magma_r", (0, worst), maker.units.name),
        maker.figure("difference left", left, "PuOr", (-most, most), about="of the range"),
    ]
    yield _section(
        "Where to trust it",
        "A bright match is a good one. Where it is dark, where the field is filled in, or where the"
        " way back misses the start, do not read the maps above.",
        maps,
        wide=True,
    )


def shares(results: Analysis) -> Array:
    """The share of the images, but that of pixels which the regulariser holds alone is 0."""
    alone = held(results.share, results.trust.map)
    found: Array = np.where(alone, 0.0, np.maximum(results.share, HELD))
    return found


def _stiffness(maker: Maker) -> Iterator[str]:
    step = maker.results.steps[0]
    if step.stiffness is None or step.stiffness.refused:
        return
    values = np.log10(step.stiffness.E)
    top = max(maker.largest(values, 100), 0.05)
    said = [f"{10**v:.2g} x" for v in (-top, 0, top)]
    maps = [maker.figure("relative modulus", values, "PuOr_r", (-top, top), said=said)]
    if step.modulus_deviation is not None and np.isfinite(step.modulus_deviation).all():
        bars = step.modulus_deviation
        highest = maker.largest(bars, 99.5)
        maps.append(maker.figure("error bar of ln E", bars, "magma_r", (0, highest)))
    yield _section("Stiffness", "Relative to the background, on a logarithmic scale.", maps)


def _table(maker: Maker) -> Iterator[str]:
    """The numbers of the summary with their units."""
    rows = "".join(
        f"<tr><td>{escape(name)}</td>" + "".join(f"<td>{escape(c)}</td>" for c in cells) + "</tr>"
        for name, cells in _numbers(maker.results, maker.units)
    )
    yield (
        '<section><h2>Numbers</h2><div class="scroll"><table><tr><th></th><th>least</th>'
        "<th>mean</th><th>most</th><th>unit</th></tr>"
        f"{rows}</table></div><p class=quiet>Of strains, 1 % of the pixels lie below the least and"
        " 1 % above the most. The share of the images is their part, against smoothness, in a"
        " detail as wide as sigma (5 px by default): small values, below 1 % too, are normal where"
        " a smooth motion is averaged over more pixels; worry if many are held by the regulariser"
        " alone. All numbers are in <code>summary.json</code>.</p></section>"
    )


def _numbers(results: Analysis, units: Units) -> Iterator[tuple[str, tuple[str, ...]]]:
    summary = results.summary
    for i, u in enumerate(results.u):
        live = u[~results.dead]
        values = (live.min(), live.mean(), live.max())
        for unit, factor in {"px": 1.0, units.name: units.factor(i)}.items():
            cells = (*(f"{factor * v:.3g}" for v in values), unit)
            yield f"{NAMES[i]} displacement u{i + 1}", cells
    for i, bar in enumerate(summary.get("deviation_median_px", ())):
        cells = ("", f"{units.factor(i) * bar:.3g}", "", units.name)
        yield f"error bar of u{i + 1}, median", cells
    for name, of in summary["strains"].items():
        cells = (*(f"{100 * of[key]:.3g}" for key in ("low", "mean", "high")), "%")
        yield f"strain {name}" if name[0] == "e" else name, cells
    back = units.factor() * summary["forward_backward_error_median_px"]
    yield "there and back, median", ("", f"{back:.3g}", "", units.name)
    yield "difference without the motion", _one(summary["residual_rms_without_motion"], "of range")
    yield "difference after the motion", _one(summary["residual_rms"], "of range")
    yield "share of the images, median", _one(100 * summary["share_of_data_median"], "%")
    yield "held by the regulariser alone", _one(100 * summary["share_held_by_regulariser"], "%")
    followed, of = sum(summary["bubbles"]), sum(summary["bubbles_found"])
    yield "bubbles followed", ("", f"{followed}", "", f"of {of}")
    yield "weight of the smoothness", ("", f"{summary['alpha'][-1]:.4g}", "", "")
    for i, side in enumerate(summary["pixel_size_um"] if units.name != "px" else ()):
        yield f"{NAMES[i]} side of a pixel", _one(side, "µm")


def _one(value: float, unit: str) -> tuple[str, str, str, str]:
    return "", f"{value:.3g}", "", unit


def _section(title: str, text: str, maps: Sequence[str], wide: bool = False) -> str:
    kind = "maps two" if wide else "maps"
    return (
        f"<section><h2>{title}</h2><p>{escape(text)}</p>"
        f'<div class="{kind}">{"".join(maps)}</div></section>'
    )


def _finding(finding: Finding) -> str:
    advice = f"<em>{escape(finding.advice)}</em>" if finding.advice else ""
    return f'<li class="{finding.level}">{escape(finding.text)}{advice}</li>'


def _template() -> str:
    return files("eofm.analysis").joinpath(TEMPLATE).read_text(encoding="utf-8")
