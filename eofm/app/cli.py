"""The command ``eofm``: one subcommand per step, options named like the settings.

Imports of the steps sit inside the subcommands, so that ``--help`` is instant.
"""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from eofm import io
from eofm.app.options import add_options, sections_of, settings_of
from eofm.errors import InputError
from eofm.settings import (
    Estimation,
    Forward,
    Identification,
    Pair,
    Phantom,
    Sample,
    Section,
    Tracking,
    VirtualOct,
)

DESCRIPTION = """\
Displacement of soft samples between an image before and one after compression.

  eofm track before.tif after.tif --output bubbles.csv
  eofm estimate before.tif after.tif --bubbles bubbles.csv --output displacement.tif

Displacements are in px: page 1 of the TIFF is lateral (to the right), page 2 axial
(down). Each step has a --help of its own.
"""


def forward(args: argparse.Namespace) -> None:
    r"""True displacement of a sample with its inclusions.

    Linear elasticity: fixed on top, moved at the bottom, free on the sides.

      eofm forward --output true.tif --compression 3 \
          --inclusions '{"x1": 60, "x2": 80, "radius": 20, "stiffness": 5}'
    """
    from eofm.elasticity.forward import true_field

    io.write_field(args.output, true_field(settings_of(Sample, args), settings_of(Forward, args)))


def background(args: argparse.Namespace) -> None:
    """Displacement of the same sample without inclusions.

    eofm background --output background.tif --height 200 --width 400 --compression 3
    """
    from eofm.elasticity.forward import background_field

    io.write_field(
        args.output, background_field(settings_of(Sample, args), settings_of(Forward, args))
    )


def phantom(args: argparse.Namespace) -> None:
    """Images of a sample full of bubbles, before and after a displacement.

    eofm phantom true.tif --reference before.tif --deformed after.tif --table true.csv
    """
    from eofm.simulation.phantom import make_phantom

    I1, I2, bubbles = make_phantom(io.read_field(args.displacement), settings_of(Phantom, args))
    io.write_image(args.reference, I1)
    io.write_image(args.deformed, I2)
    io.write_table(args.table, bubbles)


def virtual_oct(args: argparse.Namespace) -> None:
    r"""OCT tomograms of the inside of a sample, before and after a displacement.

      eofm virtual-oct true.tif background.tif --reference before.tif --deformed after.tif \
          --truth true_inside.tif --background background_inside.tif

    The sample is enlarged first; both fields are written for the region of interest, px.
    """
    from eofm.simulation.virtual_oct import make_tomograms

    u = io.read_field(args.displacement)
    found = make_tomograms(u, io.read_field(args.homogeneous), settings_of(VirtualOct, args))
    io.write_image(args.reference, found.I1)
    io.write_image(args.deformed, found.I2)
    io.write_field(args.truth, found.truth)
    io.write_field(args.background, found.background)


def track(args: argparse.Namespace) -> None:
    """Follow large speckle formations (bubbles) from one image to the next.

      eofm track before.tif after.tif --output bubbles.csv

    The table has a row per bubble: centre x1, x2 and displacement u1, u2 in px, area,
    brightness, and a quality of at most 1. Motions larger than the gate need a prediction,
    such as the background field.
    """
    from eofm.imaging.bubbles import track

    settings = settings_of(Tracking, args)
    I1, I2 = io.read_pair(args.reference, args.deformed)
    prediction = args.prediction and io.read_field(args.prediction, I1.shape)
    io.write_table(args.output, track(I1, I2, settings, prediction=prediction))


def estimate(args: argparse.Namespace) -> None:
    r"""Displacement between two images by elastographic optical flow.

      eofm estimate before.tif after.tif --bubbles bubbles.csv --output displacement.tif

    By default as accurately as this package can: second derivatives in the smoothness
    term, its weight chosen on held-out pixels. --method paper has the paper's settings.

    Without --bubbles there is no speckle term, without --background no background field.
    Where the background is known to hold at the edges, say so:

      eofm estimate before.tif after.tif --bubbles bubbles.csv \
          --background background.tif --zero-edges top bottom --output u.tif

    --deviation writes the standard deviation of u1 and u2 at each pixel.
    """
    from eofm.flow.estimate import estimate_displacement

    settings = settings_of(Estimation, args)
    I1, I2 = io.read_pair(args.reference, args.deformed)
    found = estimate_displacement(
        I1,
        I2,
        settings,
        bubbles=args.bubbles and io.read_bubbles(args.bubbles),
        background=args.background and io.read_field(args.background, I1.shape),
        progress=True,
    )
    deviation = args.deviation and found.deviation()
    io.write_field(args.output, found.u)
    if args.deviation:
        io.write_field(args.deviation, deviation)


def stiffness(args: argparse.Namespace) -> None:
    r"""Young's modulus relative to the background, and the displacement that goes with it.

      eofm stiffness before.tif after.tif --output E.tif --displacement u.tif \
          --height 108 --width 180 --compression 3.53

    The images show the whole sample, fixed on top and moved by a known compression at the
    bottom, px. --deviation writes the standard deviation of u1 and u2 of the identified
    sample, px, and --stiffness-deviation that of log E. The search ends when a step gains less than
    --least-gain, or after --iterations steps.
    """
    from eofm.identification.stiffness import identify_stiffness
    from eofm.identification.uncertainty import deviations

    sample, settings = settings_of(Sample, args), settings_of(Identification, args)
    estimation = settings_of(Estimation, args)
    I1, I2 = io.read_pair(args.reference, args.deformed)
    bubbles = args.bubbles and io.read_bubbles(args.bubbles)
    found = identify_stiffness(I1, I2, sample, settings, estimation, bubbles=bubbles, progress=True)
    bars = deviations(found) if args.deviation or args.stiffness_deviation else None
    io.write_image(args.output, found.E)
    io.write_field(args.displacement, found.estimate.u)
    if bars and args.deviation:
        io.write_field(args.deviation, bars[0])
    if bars and args.stiffness_deviation:
        io.write_image(args.stiffness_deviation, bars[1])
    print(found.summary())


def evaluate(args: argparse.Namespace) -> None:
    """Relative errors (percent) and largest errors (px) of an estimated field.

    eofm evaluate displacement.tif true.tif --output errors.csv
    """
    import pandas as pd

    from eofm.analysis.metrics import relative_errors

    truth = io.read_field(args.truth)
    found = relative_errors(io.read_field(args.estimate, truth.shape[1:]), truth)
    io.write_table(args.output, pd.DataFrame([found]))
    print("  ".join(f"{name} {value:.2f}" for name, value in found.items()))


def sample(args: argparse.Namespace) -> None:
    r"""Everything for one pair of images: displacement, strain, quality, figures.

      eofm sample --reference before.tif --deformed after.tif --folder results/mine \
          --lateral-size 3.9 --axial-size 6 --top fixed --bottom 'moved 0 -30 um' \
          --background elastic --poisson-ratio 0.48

    Writes displacement.tif (px) and displacement_um.tif, its standard deviation, strain.tif,
    bubbles.csv, summary.json and figures; with --stiffness true also the relative modulus
    of a sample that is wholly in the image. Edges of which nothing is said are free. Settings may
    come from a file (YAML, names as the options') where they are many; options win.
    """
    if args.folder.is_file():
        raise InputError(f"{args.folder}: is a file; name a folder")
    from eofm.analysis.analyse import analyse
    from eofm.analysis.report import write_results

    given = io.read_settings(args.settings) if args.settings else {}
    pair, *settings = sections_of(ANALYSIS, given, args)
    try:
        results = analyse(pair, *settings, progress=True)
    except InputError as error:
        raise InputError(f"{args.folder.name}: {error}") from None
    args.folder.mkdir(parents=True, exist_ok=True)
    write_results(results, pair, args.folder)


ANALYSIS: list[type[Section]] = [Pair, Tracking, Estimation, Identification]

PAIR = {
    "reference": "image before compression (greyscale TIFF)",
    "deformed": "image after compression, of the same size",
}

# Of each step: what it reads, by position; what it writes, by name in capitals, and may
# read, by name; its settings.
STEPS: dict[Callable[..., None], tuple[dict[str, str], dict[str, str], list[type[Section]]]] = {
    forward: ({}, {"OUTPUT": "field to write (TIFF)"}, [Sample, Forward]),
    background: ({}, {"OUTPUT": "field to write (TIFF)"}, [Sample, Forward]),
    phantom: (
        {"displacement": "true field (TIFF)"},
        {
            "REFERENCE": "image before compression to write (TIFF)",
            "DEFORMED": "image after compression to write (TIFF)",
            "TABLE": "table of the true bubbles to write (CSV)",
        },
        [Phantom],
    ),
    virtual_oct: (
        {
            "displacement": "true field of the whole sample (TIFF)",
            "homogeneous": "its background field (TIFF)",
        },
        {
            "REFERENCE": "tomogram before compression to write (TIFF)",
            "DEFORMED": "tomogram after compression to write (TIFF)",
            "TRUTH": "true field in the region of interest to write (TIFF)",
            "BACKGROUND": "background field in the region of interest to write (TIFF)",
        },
        [VirtualOct],
    ),
    track: (
        PAIR,
        {"OUTPUT": "table to write (CSV)", "prediction": "field that predicts the motion (TIFF)"},
        [Tracking],
    ),
    estimate: (
        PAIR,
        {
            "OUTPUT": "field to write (TIFF)",
            "bubbles": "table of tracked bubbles (CSV)",
            "background": "background field (TIFF)",
            "deviation": "field of standard deviations to write (TIFF)",
        },
        [Estimation],
    ),
    sample: (
        {},
        {"FOLDER": "folder to write the results to", "settings": "file of settings (YAML)"},
        ANALYSIS,
    ),
    stiffness: (
        PAIR,
        {
            "OUTPUT": "relative modulus to write (TIFF)",
            "DISPLACEMENT": "field to write (TIFF)",
            "bubbles": "table of tracked bubbles (CSV)",
            "deviation": "field of standard deviations to write (TIFF)",
            "stiffness_deviation": "standard deviation of log E to write (TIFF)",
        },
        [Sample, Identification, Estimation],
    ),
    evaluate: (
        {"estimate": "estimated field (TIFF)", "truth": "true field (TIFF)"},
        {"OUTPUT": "table to write (CSV)"},
        [],
    ),
}


# Files that are written, so that their folders can be checked before any work.
WRITTEN = {name for _, files, _ in STEPS.values() for name in files if name.isupper()}
WRITTEN = WRITTEN - {"FOLDER"} | {"deviation", "stiffness_deviation"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one step; 0 if it worked, 1 if its input cannot be used, 2 for wrong usage."""
    args = _parser().parse_args(argv)
    # Compiled loops take as many threads as the workflow gives a job.
    os.environ.setdefault("NUMBA_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "1"))
    try:
        written: list[Path] = []
        for name in STEPS[args.step][1]:
            path = getattr(args, name.lower())
            if path and name in WRITTEN:
                io.check_folder(path)
                if path in written:
                    raise InputError(f"{path}: is named for two results; give each its own file")
                written.append(path)
        args.step(args)
    except (InputError, OSError) as error:
        print(f"eofm {_name(args.step)}: {error}", file=sys.stderr)
        return 1
    except MemoryError:
        print(
            f"eofm {_name(args.step)}: not enough memory for such sizes; use smaller images,"
            " windows or regions, or larger elements",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


def _name(step: Callable[..., None]) -> str:
    return step.__name__.replace("_", "-")


def _parser() -> argparse.ArgumentParser:
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("eofm", description=DESCRIPTION, formatter_class=formatter)
    steps = parser.add_subparsers(title="steps", metavar="STEP", required=True)
    for step, (positions, files, sections) in STEPS.items():
        summary, _, rest = (step.__doc__ or "").partition("\n")
        text = "\n".join(line.removeprefix("    ") for line in rest.splitlines())
        sub = steps.add_parser(
            _name(step),
            help=summary,
            description=summary + "\n" + text,
            formatter_class=formatter,
        )
        sub.set_defaults(step=step)
        for name, help in positions.items():
            sub.add_argument(name, type=Path, help=help)
        for name, help in files.items():
            option = f"--{name.lower().replace('_', '-')}"
            sub.add_argument(option, type=Path, metavar="FILE", required=name.isupper(), help=help)
        for section in sections:
            add_options(sub.add_argument_group(section.__name__.lower()), section)
    return parser


if __name__ == "__main__":
    sys.exit(main())
