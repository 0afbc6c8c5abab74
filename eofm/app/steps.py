"""The steps of the command ``eofm``.

The signature of a step is its command line: files by position and by name, each said to be
read or written, and sections of settings whose keys become options. Imports sit inside the
functions, so that ``--help`` is instant.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from eofm import io
from eofm.app.options import Step, reads, sections_of, writes
from eofm.errors import InputError
from eofm.settings import (
    Estimation,
    Forward,
    Identification,
    Pair,
    Phantom,
    Sample,
    Scale,
    Tracking,
    VirtualOct,
)

if TYPE_CHECKING:
    from eofm.flow.trust import Trust

Before = Annotated[
    Path, reads("image before compression: TIFF, PNG, NumPy, MATLAB, HDF5 and others")
]
After = Annotated[Path, reads("image after compression, of the same size")]
Field = Annotated[Path, writes("field to write (TIFF)")]
Bubbles = Annotated[Path | None, reads("table of tracked bubbles (CSV)")]
Deviation = Annotated[Path | None, writes("field of standard deviations to write (TIFF)")]


def forward(sample: Sample, settings: Forward, *, output: Field) -> None:
    r"""True displacement of a sample with its inclusions.

    Linear elasticity: fixed on top, moved at the bottom, free on the sides.

      eofm forward --output true.tif --height 120 --width 200 --compression 3 \
          --inclusions '{"x1": 60, "x2": 80, "radius": 20, "stiffness": 5}'
    """
    from eofm.elasticity.forward import true_field

    io.write_field(output, true_field(sample, settings))


def background(sample: Sample, settings: Forward, *, output: Field) -> None:
    """Displacement of the same sample without inclusions.

    eofm background --output background.tif --height 200 --width 400 --compression 3
    """
    from eofm.elasticity.forward import background_field

    io.write_field(output, background_field(sample, settings))


def phantom(
    displacement: Annotated[Path, reads("true field (TIFF)")],
    settings: Phantom,
    *,
    reference: Annotated[Path, writes("image before compression to write (TIFF)")],
    deformed: Annotated[Path, writes("image after compression to write (TIFF)")],
    table: Annotated[Path, writes("table of the true bubbles to write (CSV)")],
) -> None:
    """Images of a sample full of bubbles, before and after a displacement.

    eofm phantom true.tif --reference before.tif --deformed after.tif --table true.csv
    """
    from eofm.simulation.phantom import make_phantom

    I1, I2, bubbles = make_phantom(io.read_field(displacement), settings)
    io.write_image(reference, I1)
    io.write_image(deformed, I2)
    io.write_table(table, bubbles)


def virtual_oct(
    displacement: Annotated[Path, reads("true field of the whole sample (TIFF)")],
    homogeneous: Annotated[Path, reads("its background field (TIFF)")],
    settings: VirtualOct,
    *,
    reference: Annotated[Path, writes("tomogram before compression to write (TIFF)")],
    deformed: Annotated[Path, writes("tomogram after compression to write (TIFF)")],
    truth: Annotated[Path, writes("true field in the region of interest to write (TIFF)")],
    background: Annotated[Path, writes("background field in the region to write (TIFF)")],
) -> None:
    r"""OCT tomograms of the inside of a sample, before and after a displacement.

      eofm virtual-oct true.tif background.tif --reference before.tif --deformed after.tif \
          --truth true_inside.tif --background background_inside.tif

    The sample is enlarged first; both fields are written for the region of interest, px.
    """
    from eofm.simulation.virtual_oct import make_tomograms

    u, u_bg = io.read_field(displacement, ndim=2), io.read_field(homogeneous, ndim=2)
    experiment = make_tomograms(u, u_bg, settings)
    io.write_image(reference, experiment.I1)
    io.write_image(deformed, experiment.I2)
    io.write_field(truth, experiment.truth)
    io.write_field(background, experiment.background)


def track(
    reference: Before,
    deformed: After,
    settings: Tracking,
    *,
    output: Annotated[Path, writes("table to write (CSV)")],
    prediction: Annotated[Path | None, reads("field that predicts the motion (TIFF)")] = None,
) -> None:
    """Follow large speckle formations (bubbles) from one image to the next.

      eofm track before.tif after.tif --output bubbles.csv

    The table has a row per bubble: centre x1, x2 and displacement u1, u2 in px, area,
    brightness, and a quality of at most 1. Motions larger than the gate need a prediction,
    such as the background field.
    """
    from eofm.imaging.bubbles import track

    I1, I2 = io.read_pair(reference, deformed)
    expected = io.read_field(prediction, I1.shape) if prediction else None
    io.write_table(output, track(I1, I2, settings, prediction=expected))


def estimate(
    reference: Before,
    deformed: After,
    settings: Estimation,
    scale: Scale,
    *,
    output: Field,
    bubbles: Bubbles = None,
    background: Annotated[Path | None, reads("background field (TIFF)")] = None,
    deviation: Deviation = None,
) -> "Trust":
    r"""Displacement between two images by elastographic optical flow.

      eofm estimate before.tif after.tif --bubbles bubbles.csv --output displacement.tif

    By default as accurately as this package can: second derivatives in the smoothness
    term, its weight chosen on held-out pixels. --method paper has the paper's settings.

    Without --bubbles there is no speckle term, without --background no background field.
    Where the background is known to hold at the edges, say so:

      eofm estimate before.tif after.tif --bubbles bubbles.csv \
          --background background.tif --zero-edges top bottom --output u.tif

    --deviation writes the standard deviation of u1 and u2 at each pixel. Where the images do not
    bear the estimate out, it says why; if they contradict it, the exit status is 3.
    """
    from eofm.flow.estimate import estimate_displacement
    from eofm.flow.known import Known
    from eofm.imaging.intensity import advise_logarithm

    first, second = io.read_scans(reference, deformed)
    I1, I2 = first.values, second.values
    advise_logarithm(I1)
    size = io.pixel_size({str(reference): first, str(deformed): second}, I1.ndim, scale.sides)
    sides = size.sides if size else None
    known = Known(
        bubbles=io.read_bubbles(bubbles) if bubbles else None,
        background=io.read_field(background, I1.shape) if background else None,
        pixel_size=sides or (1.0,) * I1.ndim,
    )
    estimate = estimate_displacement(I1, I2, settings, known, progress=True)
    bars = estimate.deviation() if deviation else None
    io.write_field(output, estimate.u, sides=sides)
    if deviation and bars is not None:
        io.write_field(deviation, bars, sides=sides, of="deviation")
    return estimate.trust


def stiffness(
    reference: Before,
    deformed: After,
    sample: Sample,
    settings: Identification,
    estimation: Estimation,
    *,
    output: Annotated[Path, writes("relative modulus to write (TIFF)")],
    displacement: Field,
    bubbles: Bubbles = None,
    deviation: Deviation = None,
    stiffness_deviation: Annotated[
        Path | None, writes("standard deviation of log E to write (TIFF)")
    ] = None,
) -> None:
    r"""Young's modulus relative to the background, and the displacement that goes with it.

      eofm stiffness before.tif after.tif --output E.tif --displacement u.tif \
          --height 108 --width 180 --compression 3.53

    The images show the whole sample, fixed on top and moved by a known compression at the
    bottom, px. --deviation writes the standard deviation of u1 and u2 of the identified
    sample, px, and --stiffness-deviation that of log E. The search ends when a step gains less than
    --least-gain, or after --iterations steps.
    """
    from eofm.flow.known import Known
    from eofm.identification.stiffness import identify_stiffness
    from eofm.identification.uncertainty import deviations

    I1, I2 = io.read_pair(reference, deformed, ndim=2)
    known = Known(bubbles=io.read_bubbles(bubbles) if bubbles else None)
    identified = identify_stiffness(I1, I2, sample, settings, estimation, known, progress=True)
    bars = deviations(identified) if deviation or stiffness_deviation else None
    io.write_image(output, identified.E)
    io.write_field(displacement, identified.estimate.u)
    if bars and deviation:
        io.write_field(deviation, bars[0], of="deviation")
    if bars and stiffness_deviation:
        io.write_image(stiffness_deviation, bars[1])
    print(identified.summary())


def evaluate(
    estimate: Annotated[Path, reads("estimated field (TIFF)")],
    truth: Annotated[Path, reads("true field (TIFF)")],
    *,
    output: Annotated[Path, writes("table to write (CSV)")],
) -> None:
    """Relative errors (percent) and largest errors (px) of an estimated field.

    eofm evaluate displacement.tif true.tif --output errors.csv
    """
    import pandas as pd

    from eofm.analysis.metrics import relative_errors

    u = io.read_field(truth)
    errors = relative_errors(io.read_field(estimate, u.shape[1:]), u)
    io.write_table(output, pd.DataFrame([errors]))
    print("  ".join(f"{name} {value:.2f}" for name, value in errors.items()))


def sample(
    pair: Pair,
    tracking: Tracking,
    estimation: Estimation,
    identification: Identification,
    *,
    folder: Annotated[Path, writes("folder to write the results to")],
    settings: Annotated[Path | None, reads("file of settings (YAML)")] = None,
) -> "Trust":
    r"""Everything for one pair of images: displacement, strain, quality, figures.

      eofm sample --reference before.tif --deformed after.tif --folder results/mine \
          --lateral-size 3.9 --axial-size 6 --top fixed --bottom 'moved 0 -30 um' \
          --background elastic --poisson-ratio 0.48

    Writes report.html, which explains the rest, displacement.tif (px) and displacement_um.tif, its
    standard deviation, strain.tif, bubbles.csv, summary.json, results.vti and figures, all of them
    or nothing; with --stiffness true also the relative modulus. Edges of which nothing is said are
    free. Settings may come from a file (YAML, names as the options') where they are many;
    options win. Where the images do not bear the estimate out, it says why; if they contradict
    it, the exit status is 3.
    """
    from eofm.analysis.analyse import analyse
    from eofm.analysis.report import KINDS, check_results
    from eofm.analysis.scene import read_scene

    check_results(folder, pair)
    try:
        scene = read_scene(pair)
        results = analyse(
            *scene.frames,
            known=scene.known,
            sample=scene.sample,
            measures=pair,
            tracking=tracking,
            estimation=estimation,
            identification=identification,
            progress=True,
        )
    except InputError as error:
        raise InputError(f"{folder.name}: {error}") from None
    results.summary["pixel_size_from"] = scene.pixel_size.source if scene.pixel_size else None
    folder.mkdir(parents=True, exist_ok=True)
    results.write(folder, pair.files, KINDS[pair.figures])
    return results.trust


def view(
    folder: Annotated[Path, reads("folder that `eofm sample` has written to")],
) -> None:
    """Show the results in a folder as layers of napari.

      eofm view results/mine

    Images, displacement with its vectors, strain and error bars, in um where the size of a pixel is
    known and in px else. Needs napari: pip install 'eofm[view]'.
    """
    from eofm.analysis.layers import layers

    shown = layers(folder)
    try:
        import napari
    except ImportError:
        raise InputError("napari is not installed; pip install 'eofm[view]' brings it") from None
    viewer = napari.Viewer(title=f"eofm: {folder.resolve().name}")
    for layer in shown:
        viewer.add_layer(napari.layers.Layer.create(*layer))
    viewer.axes.visible = viewer.scale_bar.visible = True
    napari.run()


# Settings of everything for one pair, the columns of a table of samples.
ANALYSIS = tuple(sections_of(sample).values())

STEPS: tuple[Step, ...] = (
    forward,
    background,
    phantom,
    virtual_oct,
    track,
    estimate,
    sample,
    view,
    stiffness,
    evaluate,
)
