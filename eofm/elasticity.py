"""Forward model: linearised elasticity of a compressed rectangular sample.

The sample occupies ``[0, width - 1] x [0, height - 1]`` px, its corners being the
centres of the corner pixels. It is fixed on top (Gamma_1), moved by ``g`` at the bottom
(Gamma_2) and free on its sides, eq. (bdc_Dirichlet) of the paper. Depth grows
downwards, so a compression by ``c`` px is ``g = (0, -c)``.
"""

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.sparse.linalg import splu
from skfem import (
    Basis,
    BilinearForm,
    ElementQuad2,
    ElementVector,
    MeshQuad,
    condense,
    solve,
)
from skfem.helpers import ddot, div, sym_grad

from eofm.config import Edge, Forward, Sample
from eofm.images import unit_spacing

Array = NDArray[np.float64]


def true_field(sample: Sample, forward: Forward = Forward()) -> Array:
    """Displacement of a sample with its inclusions, shape (2, height, width), px."""
    return displacement(sample, forward.true_cell)


def background_field(sample: Sample, forward: Forward = Forward()) -> Array:
    """The field u_bg of the same experiment without inclusions, eq. (Ansatz), px."""
    return displacement(sample.model_copy(update={"inclusions": ()}), forward.background_cell)


def displacement(sample: Sample, cell: float) -> Array:
    """Displacement of a sample fixed on top and moved at the bottom.

    Parameters
    ----------
    sample : Sample
        Size, materials and motion of the bottom. Where its contact slips, top and
        bottom prescribe u2 alone and the middle of the top stays where it is.
    cell : float
        Side of the biquadratic elements, px.

    Returns
    -------
    ndarray, shape (2, height, width)
        ``u`` with ``-div sigma(u) = 0`` at the pixel centres, px.
    """
    still, moved = np.zeros((2, 1)), np.array([[0.0], [-sample.compression]])
    return deform(sample, {"top": still, "bottom": moved}, cell=cell, slip=sample.contact == "slip")


def deform(
    sample: Sample,
    motion: dict[Edge, Array],
    *,
    cell: float,
    pixel_size: tuple[float, float] = (1.0, 1.0),
    slip: bool = False,
) -> Array:
    """Displacement of a sample some of whose edges move in a known way.

    Parameters
    ----------
    sample : Sample
        Size and materials; how it is pressed is stated by ``motion``.
    motion : dict of ndarray, shape (2, n)
        Displacement at n points that divide an edge evenly (n = 1: constant), px.
        The other edges are free.
    cell : float
        Side of the biquadratic elements, in units of a pixel's mean side.
    pixel_size : (lateral, axial)
        Sides of a pixel in any unit.
    slip : bool
        The edges named are held in u2 alone, and the middle of the first in u1.

    Returns
    -------
    ndarray, shape (2, height, width)
        At the pixel centres, px.
    """
    spacing = np.array(unit_spacing(pixel_size))
    basis = make_basis(sample, cell, spacing)
    nodes = _components(basis)
    x = basis.doflocs[:, nodes[0]] / spacing[:, None]
    ends = {"left": (0, 0), "right": (0, sample.width - 1)}
    ends |= {"top": (1, 0), "bottom": (1, sample.height - 1)}
    prescribed = basis.zeros()
    dofs: list[NDArray[np.int64]] = []
    for edge, g in motion.items():
        axis, end = ends[edge]
        on = np.flatnonzero(np.isclose(x[axis], end))
        along = x[1 - axis, on] / (sample.shape[axis] - 1)
        for i in (0, 1):
            at = np.linspace(0, 1, g.shape[1])
            prescribed[nodes[i, on]] = spacing[i] * np.interp(along, at, g[i])
        if slip:
            middle = on[[np.abs(along - 0.5).argmin()]]
            dofs += [nodes[1, on], *([nodes[0, middle]] if not dofs else [])]
        else:
            dofs += [nodes[0, on], nodes[1, on]]
    K = stiffness_matrix(basis, sample, spacing)
    u = solve(*condense(K, x=prescribed, D=np.unique(np.concatenate(dofs))), solver=factorise)
    return _on_pixels(sample.shape, x, u[nodes] / spacing[:, None])


def lame(sample: Sample, x: Array) -> tuple[Array, Array]:
    """Lamé parameters (lambda, mu) at points ``x`` of shape (2, ...).

    In units of the background's Young modulus: only ratios matter where the boundary
    moves by a given displacement. Plane stress replaces lambda by
    ``2 lambda mu / (lambda + 2 mu)``.
    """
    E = np.ones(x.shape[1:])
    for disc in sample.inclusions:
        E[(x[0] - disc.x1) ** 2 + (x[1] - disc.x2) ** 2 < disc.radius**2] = disc.stiffness
    nu = sample.poisson_ratio
    mu = E / (2 * (1 + nu))
    if sample.plane == "stress":
        return E * nu / (1 - nu**2), mu
    return E * nu / ((1 + nu) * (1 - 2 * nu)), mu


def make_basis(sample: Sample, cell: float, spacing: Array | tuple = (1.0, 1.0)) -> Basis:
    """Biquadratic vector elements on a uniform mesh with cells of about ``cell``.

    Lengths are those of pixels with sides ``spacing`` = (lateral, axial).
    """
    lengths = [(n - 1) * h for n, h in zip(sample.shape[::-1], spacing, strict=True)]
    sides = [np.linspace(0, length, max(2, round(length / cell)) + 1) for length in lengths]
    return Basis(MeshQuad.init_tensor(*sides), ElementVector(ElementQuad2()), intorder=4)


def stiffness_matrix(
    basis: Basis, sample: Sample, spacing: Array | tuple = (1.0, 1.0)
) -> sp.csr_array:
    """Matrix of the form ``int 2 mu eps(u):eps(v) + lambda div(u) div(v)``.

    The volumetric part uses 2 x 2 Gauss points (selective reduced integration), which
    keeps biquadratic elements free of locking as nu goes to 1/2 (Malkus and Hughes,
    Comput. Methods Appl. Mech. Eng. 15, 1978).
    """
    pixel = np.reshape(spacing, (2, 1, 1))

    @BilinearForm
    def shear(u: Any, v: Any, w: Any) -> Any:
        return 2 * lame(sample, w.x / pixel)[1] * ddot(sym_grad(u), sym_grad(v))

    @BilinearForm
    def volume(u: Any, v: Any, w: Any) -> Any:
        return lame(sample, w.x / pixel)[0] * div(u) * div(v)

    reduced = Basis(basis.mesh, basis.elem, intorder=3)
    return shear.assemble(basis) + volume.assemble(reduced)


def factorise(A: sp.csr_array, b: Array) -> Array:
    """Solve a symmetric sparse system; its ordering halves the time of the default."""
    lu = splu(A.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return lu.solve(b)


def _components(basis: Basis) -> NDArray[np.int64]:
    """Degrees of freedom of u1 and of u2, in the same order of their nodes."""
    kinds = basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs
    return np.stack([np.concatenate([dofs[i] for dofs in kinds]) for i in (0, 1)])


def _on_pixels(shape: tuple[int, int], x: Array, u: Array) -> Array:
    """Cubic splines through values on a tensor grid of nodes, at the pixel centres."""
    x = x.round(9)
    x1, x2 = (np.unique(c) for c in x)
    order = np.lexsort(x)
    rows, columns = (np.arange(n) for n in shape)
    return np.stack(
        [RectBivariateSpline(x2, x1, c[order].reshape(len(x2), len(x1)))(rows, columns) for c in u]
    )
