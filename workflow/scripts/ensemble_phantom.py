"""One random phantom: its sample, fields and images, and what each method makes of them.

The preset without knowledge, ``preset_free``, gets the images alone, as other tools do.
"""

from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import eofm
from eofm import io
from eofm.app.config import Ensemble
from eofm.compiled import use_threads
from eofm.elasticity.forward import lame
from eofm.imaging.intensity import normalise

Array = NDArray[np.float64]

# Of dense speckle: bubbles per px, and the noise as a part of the images' range.
SPECKLE = {"sigma": (1.2, 1.8), "brightness": (0.3, 1.0), "noise": 0.0}
DENSITY = 0.08
NOISE = 0.05
ATTEMPTS = 1000


def draw(settings: Ensemble, sample: eofm.Sample, number: int) -> tuple[eofm.Sample, bool]:
    """Sample ``number``, from 1, of an ensemble, and whether it is of dense speckle."""
    order = np.random.default_rng([settings.seed, 0])
    two, speckle = (order.permutation(settings.count) + 1 for _ in range(2))
    rng = np.random.default_rng([settings.seed, number])
    changes = {
        "poisson_ratio": settings.poisson_ratio,
        "compression": rng.uniform(*settings.compression),
        "inclusions": place(settings, sample, 1 + (number in two[: settings.two]), rng),
    }
    return sample.changed(**changes), number in speckle[: settings.speckle]


def place(
    settings: Ensemble, sample: eofm.Sample, count: int, rng: np.random.Generator
) -> tuple[eofm.Inclusion, ...]:
    """Discs that touch neither each other nor the sample's edges."""
    last = np.reshape(sample.shape[::-1], (2, 1)) - 1.0
    for _ in range(ATTEMPTS):
        radius = sample.height * rng.uniform(*settings.radius, count)
        if (radius + 1 >= last / 2).any():
            continue
        x = rng.uniform(radius + 1, last - radius - 1)
        if count == 1 or np.hypot(*(x[:, 0] - x[:, 1])) > radius.sum() + 1:
            stiffness = np.exp(rng.uniform(*np.log(settings.stiffness), count))
            columns = zip(*x, radius, stiffness, strict=True)
            return tuple(
                eofm.Inclusion(x1=x1, x2=x2, radius=r, stiffness=E) for x1, x2, r, E in columns
            )
    raise eofm.InputError("ensemble: inclusions do not fit into the sample; lower the radius")


def render(u: Array, phantom: eofm.Phantom, speckle: bool) -> tuple[Array, Array]:
    """Images of bubbles as in the paper, or of dense, noisy speckle that fills [0, 1]."""
    if not speckle:
        return eofm.make_phantom(u, phantom)[:2]
    dense = phantom.changed(**(SPECKLE | {"count": round(DENSITY * u[0].size)}))
    images = np.stack(eofm.make_phantom(u, dense)[:2])
    noise = np.random.default_rng([phantom.seed, 3]).normal(size=images.shape)
    return normalise(*(images + NOISE * np.ptp(images) * noise))


def overlap(E: Array, truth: Array) -> float:
    """Dice coefficient of the inclusions, which may be stiff or soft.

    Found is where log E departs from the background's by half of the least true contrast.
    """
    inside, contrast = truth != 1, np.abs(np.log(truth))
    found = np.abs(np.log(E)) > contrast[inside].min() / 2
    return float(2 * (found & inside).sum() / (found.sum() + inside.sum()))


def main() -> None:
    """Write all files of a phantom, and a row of relative errors."""
    number = int(snakemake.wildcards.number)
    use_threads(snakemake.threads)
    given, out = snakemake.params, {k: Path(v) for k, v in snakemake.output.items()}
    ensemble = Ensemble(**given.ensemble)
    sample, speckle = draw(ensemble, eofm.Sample(**given.sample), number)
    print(f"phantom {number}, {'dense speckle' if speckle else 'bubbles'}: {sample}")
    forward = eofm.Forward(**given.forward)
    truth, background = eofm.true_field(sample, forward), eofm.background_field(sample, forward)
    phantom = eofm.Phantom(**given.phantom | {"seed": 1000 * ensemble.seed + number})
    I1, I2 = render(truth, phantom, speckle)
    for name, image in (("reference", I1), ("deformed", I2)):
        io.write_image(out[name], image)
    # All methods and tools see what is in the files.
    I1, I2 = io.read_pair(out["reference"], out["deformed"])

    try:
        bubbles = eofm.track(I1, I2, eofm.Tracking(**given.tracking), prediction=background)
    except eofm.InputError as error:
        print(f"no bubbles: {error}")
        bubbles = pd.DataFrame(columns=list(io.BUBBLE_COLUMNS), dtype=float)
    io.write_table(out["bubbles"], bubbles)
    known = eofm.Known(bubbles=bubbles, background=background)
    preset = eofm.Estimation(**given.preset)
    free = preset.changed(zero_edges=())
    fields = {"background": background}
    for name, settings, knowledge in (
        ("test5", eofm.Estimation(**given.estimation), known),
        ("preset_free", free, eofm.Known()),
        ("preset", preset, known),
    ):
        fields[name] = eofm.estimate_displacement(I1, I2, settings, knowledge).u
    # The inclusions are what is sought.
    plain = sample.changed(inclusions=())
    identification = eofm.Identification(**given.identification)
    found = eofm.identify_stiffness(
        I1, I2, plain, identification, preset, known=eofm.Known(bubbles=bubbles)
    )
    fields["test6"] = found.estimate.u
    deviation, deviation_E = eofm.deviations(found)

    x = np.mgrid[: sample.height, : sample.width][::-1].astype(float)
    E = lame(sample, x)[1] / lame(plain, x)[1]
    row = {name: eofm.relative_errors(u, truth)["e_rel"] for name, u in fields.items()}
    row["dice"] = overlap(found.E, E)
    row["coverage"] = float(np.mean(np.abs(fields["test6"] - truth) <= deviation))
    within = np.abs(np.log(found.E / E)) <= deviation_E
    print(f"coverage of log E: {within.mean():.3f}; {len(bubbles)} bubbles")
    print(found.summary())
    for name, u in ({"true": truth} | fields).items():
        io.write_field(out[name], u)
    labels = ["E, true", "E, identified", "sd of log E"]
    io.write_pages(out["stiffness"], np.stack([E, found.E, deviation_E]), labels)
    io.write_field(out["deviation"], deviation)
    io.write_table(out["errors"], pd.DataFrame([{"phantom": number} | row]))


with Path(snakemake.log[0]).open("w") as log, redirect_stdout(log):
    main()
