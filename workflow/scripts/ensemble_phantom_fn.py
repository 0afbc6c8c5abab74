"""One random phantom: its sample, fields and images, and what each method makes of them.

The preset without knowledge, ``preset_free``, gets the images alone, as other tools do. Of a
part cut out of a sample nothing else is known to any method.
"""

from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pandas as pd
from ensemble_draw import Draw, draw, render
from numpy.typing import NDArray

import eofm
from eofm import io
from eofm.app.config import Config
from eofm.compiled import use_threads

Array = NDArray[np.float64]

# A weaker contrast cannot be seen in a Dice coefficient.
WEAK = np.log(1.25)
CUT = eofm.Known(outside=("left", "right", "top", "bottom"))


def overlap(E: Array, truth: Array) -> float:
    """Dice coefficient of the inclusions, which may be stiff or soft; none without any.

    Found is where log E departs from the background's by half of the least true contrast;
    inclusions of a `WEAK` one are left out.
    """
    contrast = np.abs(np.log(truth))
    inside, counts = contrast > WEAK, (contrast > WEAK) | (contrast == 0)
    if not inside.any():
        return float("nan")
    found = (np.abs(np.log(E)) > contrast[inside].min() / 2) & counts
    return float(2 * (found & inside).sum() / (found.sum() + inside.sum()))


def estimates(
    config: Config, phantom: Draw, I1: Array, I2: Array
) -> tuple[dict[str, Array], eofm.Known, eofm.Estimation]:
    """Displacements by method, and what the preset knows and how it works."""
    preset = config.preset
    free = preset.changed(zero_edges=())
    alone = eofm.estimate_displacement(I1, I2, free).u
    if phantom.cut:
        none = np.zeros_like(alone)
        paper = config.estimation.changed(zero_edges=())
        test5 = eofm.estimate_displacement(I1, I2, paper).u
        fields = {"background": none, "test5": test5, "preset_free": alone, "preset": alone}
        return fields, CUT, free
    background = eofm.background_field(phantom.shown, config.forward)
    try:
        bubbles = eofm.track(I1, I2, config.tracking, prediction=background)
    except eofm.InputError as error:
        print(f"no bubbles: {error}")
        bubbles = pd.DataFrame(columns=list(io.BUBBLE_COLUMNS), dtype=float)
    known = eofm.Known(bubbles=bubbles, background=background)
    fields = {"background": background, "preset_free": alone}
    for name, settings in (("test5", config.estimation), ("preset", preset)):
        fields[name] = eofm.estimate_displacement(I1, I2, settings, known).u
    return fields, eofm.Known(bubbles=bubbles), preset


def main() -> None:
    """Write all files of a phantom, and a row of relative errors."""
    number = int(snakemake.wildcards.number)
    use_threads(snakemake.threads)
    out = {k: Path(v) for k, v in snakemake.output.items()}
    config = Config.parse(dict(snakemake.params.items()), "ensemble")
    phantom = draw(config.ensemble, config.sample, number)
    print(f"phantom {number}: {phantom}")
    truth = eofm.true_field(phantom.sample, config.forward)
    I1, I2 = render(truth, phantom, config, 1000 * config.ensemble.seed + number)
    truth = truth[:, *phantom.region]
    for name, image in (("reference", I1), ("deformed", I2)):
        io.write_image(out[name], image)
    # All methods and tools see what is in the files.
    I1, I2 = io.read_pair(out["reference"], out["deformed"])
    fields, known, estimation = estimates(config, phantom, I1, I2)
    found = eofm.identify_stiffness(I1, I2, phantom.shown, config.identification, estimation, known)
    fields["test6"] = found.estimate.u
    none = pd.DataFrame(columns=list(io.BUBBLE_COLUMNS), dtype=float)
    io.write_table(out["bubbles"], none if known.bubbles is None else known.bubbles)
    deviation, deviation_E = eofm.deviations(found)

    # A part of a sample shows E up to a factor.
    E = phantom.modulus / np.median(phantom.modulus)
    row = {name: eofm.relative_errors(u, truth)["e_rel"] for name, u in fields.items()}
    verdict = "refused" if found.refused else "found" if found.contrast else "none"
    within = np.abs(np.log(found.E / E)) <= deviation_E
    row |= {
        # A refusal is no wrong outline; the verdict counts it.
        "dice": np.nan if found.refused else overlap(found.E, E),
        "modulus_error": np.exp(np.median(np.abs(np.log(found.E / E)[E != 1]))) - 1
        if (E != 1).any()
        else np.nan,
        "verdict": verdict,
        "coverage": float(np.mean(np.abs(fields["test6"] - truth) <= deviation)),
        "coverage_modulus": np.nan if found.refused else float(within.mean()),
    }
    print(found.summary())
    for name, u in ({"true": truth} | fields).items():
        io.write_field(out[name], u)
    labels = ["E, true", "E, identified", "sd of log E"]
    io.write_pages(out["stiffness"], np.stack([E, found.E, deviation_E]), labels)
    io.write_field(out["deviation"], deviation)
    kind = {
        "half": "tuned" if number % 2 else "reported",
        "renderer": phantom.renderer,
        "noise": phantom.noise,
        "brightness": phantom.brightness,
        "inclusions": len(phantom.sample.inclusions),
        "cut": phantom.cut,
    }
    io.write_table(out["errors"], pd.DataFrame([{"phantom": number} | kind | row]))


