"""Compare EOFM with other tools on a real frame that is moved by a known field.

    pip install '.[peers]'
    python workflow/scripts/compare_peers.py frame.tif --motion 6 --output errors.csv

The frame is the image after compression; the one before is sampled from it, so that the
true displacement is known. Brightness of the second frame falls to 0.7, both get 5 % of noise.
Every tool sees the same locally normalised images, in windows of 20 px. Settings: EOFM is run
once, with the preset; every other tool with that of peers.py, TV-L1 and DIS with each of several,
of which the best against the truth counts.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd
import peers
from numpy.typing import NDArray
from scipy import ndimage

import eofm
from eofm import io
from eofm.grid import inside
from eofm.imaging.intensity import normalise, normalise_locally
from eofm.imaging.splines import evaluate

Array = NDArray[np.float64]

WINDOW = 20.0
SETTINGS = eofm.Estimation(local_window=WINDOW)
TRIED: dict[str, list[dict[str, float]]] = {
    "tvl1": [{"attachment": a, "blur": b} for a in (3.0, 7.0, 15.0) for b in (0.0, 1.0, 2.0)],
    "dis": [{"finest_scale": s, "blur": b} for s in (0, 1) for b in (0.0, 1.5, 3.0)],
}


def make_pair(frame: Array, motion: float, seed: int) -> tuple[Array, Array, Array]:
    """Images before and after, and the true displacement: a compression that bulges."""
    height, width = frame.shape
    x2, x1 = np.mgrid[:height, :width].astype(float)
    depth, side = x2 / (height - 1), x1 / (width - 1) - 0.5
    u = motion * np.stack([0.5 * side * np.sin(np.pi * depth), -depth])
    u[1] += 0.08 * motion * np.sin(2 * np.pi * x2 / 300) * np.cos(np.pi * x1 / width)
    rng = np.random.default_rng(seed)
    noise = 0.05 * (np.percentile(frame, 99.5) - frame.min()) * rng.normal(size=(2, *frame.shape))
    I1 = evaluate(frame, np.stack([x1, x2]) + u)
    return I1 + noise[0], 0.7 * frame + noise[1], u


def main() -> None:
    """Print and write mean errors where there is signal."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("frame", type=Path, help="greyscale image")
    parser.add_argument("--motion", type=float, default=6.0, help="displacement at the bottom, px")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise")
    parser.add_argument("--output", type=Path, help="table to write (CSV)")
    args = parser.parse_args()
    frame = io.read_image(args.frame)
    I1, I2, u = make_pair(frame, args.motion, args.seed)
    x = u + np.mgrid[: frame.shape[0], : frame.shape[1]][::-1]
    brightness = ndimage.gaussian_filter(frame, 8)
    counted = inside(frame.shape, x) & (brightness > np.median(brightness))
    local = [normalise_locally(I, (WINDOW, WINDOW)) for I in normalise(I1, I2)]
    rows = []

    def run(tool: str, setting: dict[str, float], part: slice) -> Array | None:
        if tool == "eofm":
            return eofm.estimate_displacement(I1[part, part], I2[part, part], SETTINGS).u
        return peers.estimate(tool, *(I[part, part] for I in local), **setting)

    for tool in ("eofm", *peers.TOOLS):
        # Importing and compiling are not counted.
        if run(tool, {}, slice(128)) is None:
            continue
        for setting in TRIED.get(tool, [{}]):
            start = time.perf_counter()
            found = run(tool, setting, slice(None))
            row = {"tool": tool, "setting": " ".join(f"{k}={v:g}" for k, v in setting.items())}
            row["seconds"] = time.perf_counter() - start
            row["mean_error_px"] = float(np.hypot(*(found - u))[counted].mean())
            rows.append(row)
    table = pd.DataFrame(rows).sort_values("mean_error_px").groupby("tool", sort=False).head(1)
    print(table.to_string(index=False))
    if args.output:
        io.write_table(args.output, table)


if __name__ == "__main__":
    main()
