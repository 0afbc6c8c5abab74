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

from eofm.config import Forward, Sample

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
    basis = make_basis(sample, cell)
    nodes = _components(basis)
    x1, x2 = basis.doflocs[:, nodes[0]]
    top, bottom = x2 == 0, x2 == sample.height - 1
    prescribed = basis.zeros()
    prescribed[nodes[1, bottom]] = -sample.compression
    if sample.contact == "slip":
        held = np.flatnonzero(top)[[np.abs(x1[top] - x1.max() / 2).argmin()]]
    else:
        held = np.flatnonzero(top | bottom)
    dofs = np.concatenate([nodes[0, held], nodes[1, top | bottom]])
    K = stiffness_matrix(basis, sample)
    u = solve(*condense(K, x=prescribed, D=dofs), solver=factorise)
    return _on_pixels(sample.shape, np.stack([x1, x2]), u[nodes])


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


def make_basis(sample: Sample, cell: float) -> Basis:
    """Biquadratic vector elements on a uniform mesh with cells of about ``cell`` px."""
    sides = [np.linspace(0, n - 1, max(1, round((n - 1) / cell)) + 1) for n in sample.shape[::-1]]
    return Basis(MeshQuad.init_tensor(*sides), ElementVector(ElementQuad2()), intorder=4)


def stiffness_matrix(basis: Basis, sample: Sample) -> sp.csr_array:
    """Matrix of the form ``int 2 mu eps(u):eps(v) + lambda div(u) div(v)``.

    The volumetric part uses 2 x 2 Gauss points (selective reduced integration), which
    keeps biquadratic elements free of locking as nu goes to 1/2 (Malkus and Hughes,
    Comput. Methods Appl. Mech. Eng. 15, 1978).
    """

    @BilinearForm
    def shear(u: Any, v: Any, w: Any) -> Any:
        return 2 * lame(sample, w.x)[1] * ddot(sym_grad(u), sym_grad(v))

    @BilinearForm
    def volume(u: Any, v: Any, w: Any) -> Any:
        return lame(sample, w.x)[0] * div(u) * div(v)

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
