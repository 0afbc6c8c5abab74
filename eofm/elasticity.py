"""Forward model: linearised elasticity of a compressed rectangular sample.

The sample occupies ``[0, width - 1] x [0, height - 1]`` px, its corners being the
centres of the corner pixels. It is fixed on top (Gamma_1), moved by ``g`` at the bottom
(Gamma_2) and free on its sides, see eq. (bdc_Dirichlet) of the paper. Depth grows
downwards, so a compression has ``g2 < 0``.
"""

from dataclasses import dataclass

import numpy as np
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

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Disc:
    """A circular inclusion: centre and radius in px, and its stiffness ratio.

    ``stiffness`` is Young's modulus relative to that of the background.
    """

    centre: tuple[float, float]
    radius: float
    stiffness: float


@dataclass(frozen=True)
class Material:
    """Isotropic elastic sample: a background of modulus 1 with circular inclusions.

    Only ratios of moduli matter, since the boundary moves by a given displacement.
    """

    poisson_ratio: float
    inclusions: tuple[Disc, ...] = ()
    plane: str = "strain"

    def lame(self, x: Array) -> tuple[Array, Array]:
        """Lamé parameters (lambda, mu) at points ``x`` of shape (2, ...)."""
        E = np.ones(x.shape[1:])
        for disc in self.inclusions:
            c1, c2 = disc.centre
            E[(x[0] - c1) ** 2 + (x[1] - c2) ** 2 < disc.radius**2] = disc.stiffness
        nu = self.poisson_ratio
        mu = E / (2 * (1 + nu))
        if self.plane == "stress":
            return E * nu / (1 - nu**2), mu
        return E * nu / ((1 + nu) * (1 - 2 * nu)), mu


def mesh(shape: tuple[int, int], cell: float) -> MeshQuad:
    """Uniform mesh of the sample, with cells of about ``cell`` px."""
    height, width = (n - 1 for n in shape)
    x1 = np.linspace(0, width, max(1, round(width / cell)) + 1)
    x2 = np.linspace(0, height, max(1, round(height / cell)) + 1)
    return MeshQuad.init_tensor(x1, x2).with_boundaries(
        {
            "top": lambda x: np.isclose(x[1], 0),
            "bottom": lambda x: np.isclose(x[1], height),
        }
    )


def stiffness_matrix(basis: Basis, material: Material):
    """Matrix of the form ``int 2 mu eps(u):eps(v) + lambda div(u) div(v)``.

    The volumetric part uses 2 x 2 Gauss points (selective reduced integration), which
    keeps the biquadratic elements free of locking as nu goes to 1/2 (Malkus and
    Hughes, Comput. Methods Appl. Mech. Eng. 15, 1978).
    """

    @BilinearForm
    def shear(u, v, w):
        return 2 * material.lame(w.x)[1] * ddot(sym_grad(u), sym_grad(v))

    @BilinearForm
    def volume(u, v, w):
        return material.lame(w.x)[0] * div(u) * div(v)

    reduced = Basis(basis.mesh, basis.elem, intorder=3)
    return shear.assemble(basis) + volume.assemble(reduced)


def displacement(
    shape: tuple[int, int],
    material: Material,
    g: tuple[float, float],
    *,
    slip: bool = False,
    cell: float = 1.0,
) -> "Field":
    """Displacement of a sample fixed on top and moved by ``g`` at the bottom.

    Parameters
    ----------
    shape : (height, width)
        Size of the image, which shows the whole sample, in px.
    material : Material
        The elastic parameters.
    g : (g1, g2)
        Motion of the bottom in px; a compression has ``g2 < 0``.
    slip : bool
        Let top and bottom slide sideways: only ``u2`` is prescribed there, and the
        middle of the top is held against rigid motion.
    cell : float
        Side of the biquadratic elements in px.

    Returns
    -------
    Field
        The displacement, which can be evaluated anywhere in the sample.

    Notes
    -----
    Solves ``-div sigma(u) = 0`` with the boundary conditions (bdc_Dirichlet).
    """
    basis = Basis(mesh(shape, cell), ElementVector(ElementQuad2()), intorder=4)
    nodes = np.stack([_component(basis, i) for i in (0, 1)])
    depth = basis.doflocs[1, nodes[1]]
    x = basis.zeros()
    constrained = []
    for i in (0, 1):
        bottom = nodes[i, depth == shape[0] - 1]
        x[bottom] = g[i]
        constrained += [nodes[i, depth == 0], bottom] if i == 1 or not slip else []
    if slip:
        middle = np.abs(basis.doflocs[:, nodes[0]].T - [(shape[1] - 1) / 2, 0]).sum(1).argmin()
        constrained.append(nodes[0, [middle]])
        x[nodes[0]] = 0
    K = stiffness_matrix(basis, material)
    u = solve(*condense(K, x=x, D=np.concatenate(constrained)), solver=_factorise)
    return Field(basis.doflocs[:, nodes[0]], u[nodes])


class Field:
    """A displacement known on a tensor grid, evaluated by cubic splines.

    Parameters
    ----------
    x : ndarray, shape (2, n)
        The points of the grid, in any order, px.
    u : ndarray, shape (2, n)
        The displacements there, px.
    """

    def __init__(self, x: Array, u: Array) -> None:
        order = np.lexsort(x.round(9))
        x1, x2 = (np.unique(c.round(9)) for c in x)
        self._splines = [
            RectBivariateSpline(x2, x1, c[order].reshape(len(x2), len(x1))) for c in u
        ]

    def __call__(self, x1: Array, x2: Array) -> Array:
        """Displacement at points, shape (2, n), px."""
        return np.stack([s(x2, x1, grid=False) for s in self._splines])

    def on_pixels(self, shape: tuple[int, int]) -> Array:
        """Displacement at the pixel centres, shape (2, height, width), px."""
        x2, x1 = (np.arange(n, dtype=float) for n in shape)
        return np.stack([s(x2, x1) for s in self._splines])


def _component(basis: Basis, i: int) -> NDArray[np.int64]:
    return np.concatenate(
        [basis.nodal_dofs[i], basis.facet_dofs[i], basis.interior_dofs[i]]
    )


def _factorise(A, b):
    return splu(A.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(b)
