"""Errors of one pair under all conditions: the preset, what it was, and other tools.

Other tools get locally normalised images, without which none of them survives the conditions.
"""

from contextlib import redirect_stdout
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import peers
import scenes
from conditions import CONDITIONS, under
from numpy.typing import NDArray
from skimage import data
from textures import PHOTOS

import eofm
from eofm import io
from eofm.app.config import Robustness
from eofm.compiled import use_threads
from eofm.imaging.intensity import normalise, normalise_locally

Array = NDArray[np.float64]

PRESETS = {
    "preset": eofm.Estimation(),
    "preset_plain": eofm.Estimation(robust=False),
    "preset_local": eofm.Estimation(robust=False, local_window=8.0),
}
WINDOW = 20.0


def pairs(settings: Robustness, name: str, half: str, frame: str | None) -> dict[str, scenes.Scene]:
    """All conditions and motions of a scene, from the one that changes nothing."""
    held = half == "held"
    seed, shape = settings.seed + held, (settings.size, settings.size)
    render = scenes.RENDERERS.get(name, scenes.scattered)
    if frame is not None or name in PHOTOS:
        image = io.read_image(Path(frame)) if frame else getattr(data, PHOTOS[name][held])()
        shape = tuple(min(n, settings.size) for n in image.shape)
        render = partial(scenes.frame, image)
    u = scenes.smooth_motion(shape, settings.motion, seed)
    clean = render(u, seed)
    if name == "large":
        return {"none": clean} | {
            motion: render(u, seed) for motion, u in scenes.large_motions(shape).items()
        }
    return {condition: under(clean, condition, seed) for condition in CONDITIONS} | {
        name: render(u + motion(shape), seed) for name, motion in scenes.MOTIONS.items()
    }


def measure(scene: scenes.Scene, tool: str) -> dict[str, float | str]:
    """Mean error where there is signal, and what the estimate says of it."""
    nothing = {"coverage_1": np.nan, "coverage_196": np.nan, "verdict": ""}
    if tool not in PRESETS:
        I1, I2 = (normalise_locally(I, (WINDOW, WINDOW)) for I in normalise(scene.I1, scene.I2))
        u = peers.estimate(tool, I1, I2)
        return {"error_px": np.nan if u is None else error(scene, u)} | nothing
    try:
        found = eofm.estimate_displacement(scene.I1, scene.I2, PRESETS[tool])
    except eofm.InputError as refusal:
        print(f"{tool}: {refusal}")
        return {"error_px": np.nan} | nothing | {"verdict": "refused"}
    off, deviation = np.abs(found.u - scene.u), found.deviation(16)

    def within(k: float) -> float:
        return float((off <= k * deviation)[:, scene.counted].mean())

    coverage = {"coverage_1": within(1), "coverage_196": within(1.96)}
    return {"error_px": error(scene, found.u)} | coverage | {"verdict": found.trust.verdict}


def error(scene: scenes.Scene, u: Array) -> float:
    """Mean length of the error where there is signal, px."""
    return float(np.hypot(*(u - scene.u))[scene.counted].mean())


def main() -> None:
    """Write a row for each condition and tool."""
    use_threads(snakemake.threads)
    settings = Robustness(**snakemake.params.robustness)
    name, half = snakemake.wildcards.scene, snakemake.wildcards.half
    frame = next(iter(snakemake.input.frame), None)
    rows = []
    for tool in (*PRESETS, *settings.tools):
        for condition, scene in pairs(settings, name, half, frame).items():
            row = {"pair": name, "half": half, "condition": condition, "tool": tool}
            rows.append(row | measure(scene, tool))
            print(rows[-1])
    table = pd.DataFrame(rows)
    clean = table[table.condition == "none"].set_index("tool")["error_px"]
    table.insert(5, "ratio_to_clean", table["error_px"] / table["tool"].map(clean))
    io.write_table(Path(snakemake.output[0]), table)


with Path(snakemake.log[0]).open("w") as log, redirect_stdout(log):
    main()
