"""The theorem in numbers: convergence, dependence on the data, uniqueness, and weak edges.

F of the first pixels of the phantom, on which ``a`` fits into memory as a matrix.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh, splu

import eofm
from eofm import io
from eofm.flow.functional import Pointwise, Quadratic, data_term, hold_edges, smoothness_energy
from eofm.flow.multigrid import multigrid
from eofm.grid import Grid
from eofm.imaging.splines import gradient

Array = NDArray[np.float64]
Row = dict[str, Any]

SHAPE = (41, 61)
# Iterations after which a right-hand side is about the worst one.
POWER = 30


def convergence(cells: list[int]) -> Iterator[Row]:
    """Error of a smooth problem with a known solution, v = 0 above and below."""
    for n in cells:
        grid = Grid((n + 1, n + 1), (1 / n, 1 / n))
        x1, x2 = np.meshgrid(*grid.axes)
        v = np.stack([np.cos(np.pi * x1), np.cos(2 * np.pi * x1)]) * np.sin(np.pi * x2)
        load = np.reshape([2, 5], (2, 1, 1)) * np.pi**2 * v
        g = np.stack([1 + x1 * x2, np.cos(x2)])
        A = np.stack([g[0] ** 2 + 1, g[0] * g[1], g[1] ** 2 + 1])
        b = load + Pointwise(A, 0 * v).product(v)
        F = Quadratic(grid, Pointwise(A, b), 1.0, fixed(grid.shape))
        error = multigrid(F, tol=1e-11) - v
        yield {"series": "error", "x": 1 / n, "y": float(np.sqrt((error**2).mean()))}


def fixed(shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Free pixels, with v = 0 on Gamma_1 and Gamma_2."""
    free = np.ones(shape, dtype=bool)
    free[[0, -1]] = False
    return free


def forms(F: Quadratic) -> tuple[sp.csc_array, sp.csc_array]:
    """Matrices of ``a`` and of the inner product of H1, on the free pixels."""
    mass = sp.diags_array(F.grid.areas.ravel())
    H = mass + smoothness_energy(F.grid, "gradient")
    keep = np.flatnonzero(np.tile(F.free.ravel(), 2))
    return F.a().tocsc(), sp.block_diag([H, H], format="csr")[keep][:, keep].tocsc()


def coercivity(F: Quadratic) -> float:
    """Least ``a(v, v) / |v|^2`` in H1."""
    a, H = forms(F)
    return float(eigsh(a, 1, H, sigma=-1e-6, which="LM", return_eigenvectors=False)[0])


def dependence(images: tuple[Array, Array], alphas: list[float]) -> Iterator[Row]:
    """``|v| / |b|`` in H1 and its dual space, of noise, of the images and of the worst b."""
    grid, rng = Grid(SHAPE), np.random.default_rng(1)
    g, I_t = gradient(images[0]), images[1] - images[0]
    for alpha in alphas:
        F = Quadratic(grid, data_term(g, I_t, np.ones(SHAPE, dtype=bool)), alpha, fixed(SHAPE))
        a, H = forms(F)
        solve, represent = splu(a).solve, splu(H).solve
        noise, worst = rng.standard_normal((2, H.shape[0]))
        for _ in range(POWER):
            worst = H @ solve(worst)
            worst /= np.linalg.norm(worst)
        for series, b in (("noise", noise), ("the images' b", F.b()), ("worst b", worst)):
            v, f = solve(b), represent(b)
            yield {"series": series, "x": alpha, "y": float(np.sqrt((v @ (H @ v)) / (b @ f)))}
        # Poincare's inequality between two edges a height apart.
        bound = (1 + (grid.lengths[1] / np.pi) ** 2) / (2 * alpha)
        yield {"series": "bound by R alone", "x": alpha, "y": bound}
        yield {"series": "1 / coercivity", "x": alpha, "y": 1 / coercivity(F)}


def independence(parts: list[float]) -> Iterator[Row]:
    """Coercivity and answers as the second component of grad I tends to a multiple of the first."""
    grid = Grid(SHAPE)
    x1, x2 = np.meshgrid(*grid.axes)
    for part in parts:
        g = np.stack([np.cos(x1 / 3), np.cos(x1 / 3) + part * np.sin(x2 / 4)])
        for series, free in (("no edges", np.ones(SHAPE, dtype=bool)), ("v = 0", fixed(SHAPE))):
            terms = data_term(g, -g.sum(0), np.ones(SHAPE, dtype=bool))
            F = Quadratic(grid, terms, 0.8, free)
            row: Row = {"series": f"coercivity, {series}", "x": part, "y": coercivity(F)}
            try:
                multigrid(F)
            except eofm.InputError as error:
                row["refused"] = str(error)
            yield row


def weak_edges(images: tuple[Array, Array], weights: list[float]) -> Iterator[Row]:
    """Largest distance of the minimiser with B from that with exact edges, and on the edges."""
    grid = Grid(SHAPE)
    g, I_t = gradient(images[0]), images[1] - images[0]
    data = data_term(g, I_t, np.ones(SHAPE, dtype=bool))
    exact = multigrid(Quadratic(grid, data, 0.8, fixed(SHAPE)), tol=1e-10)
    zero = {edge: np.zeros((2, SHAPE[1])) for edge in ("top", "bottom")}
    for weight in weights:
        terms = Pointwise(data.A.copy(), data.b.copy())
        hold_edges(terms, grid, zero, weight)
        v = multigrid(Quadratic(grid, terms, 0.8, np.ones(SHAPE, dtype=bool)), tol=1e-10)
        yield {"series": "anywhere", "x": weight, "y": float(np.abs(v - exact).max())}
        yield {"series": "on the edges", "x": weight, "y": float(np.abs(v[:, [0, -1]]).max())}


def main() -> None:
    """Write a row for each number."""
    I1, I2 = io.read_pair(Path(snakemake.input.reference), Path(snakemake.input.deformed))
    images = tuple(I[: SHAPE[0], : SHAPE[1]] for I in (I1, I2))
    most = snakemake.params.values
    parts = {
        "convergence": convergence([8, 16, 32, 64, 128, 256][:most]),
        "dependence": dependence(images, [0.0125, 0.05, 0.2, 0.8, 3.2, 12.8][:most]),
        "independence": independence([1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0][:most]),
        "weak edges": weak_edges(images, [1e-2, 1e-1, 1.0, 10.0, 1e2, 1e3, 1e4][:most]),
    }
    rows = [{"part": part} | row for part, found in parts.items() for row in found]
    table = pd.DataFrame(rows).reindex(columns=["part", "series", "x", "y", "refused"])
    # Over many orders of magnitude, six decimals would not do.
    table["y"] = table.y.map("{:.6g}".format)
    io.write_table(Path(snakemake.output[0]), table)
    Path(snakemake.log[0]).write_text(f"{len(table)} numbers\n")


main()
