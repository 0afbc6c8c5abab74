"""Forward model: linearised elasticity of a compressed rectangular sample.

The sample occupies ``[0, width - 1] x [0, height - 1]`` px, its corners being the
centres of the corner pixels. It is fixed on top (Gamma_1), moved by ``g`` at the bottom
(Gamma_2) and free on its sides, eq. (bdc_Dirichlet) of the paper. Depth grows
downwards, so a compression by ``c`` px is ``g = (0, -c)``. A sample that has a third side is
a box, see `eofm.elasticity.box`.
"""

from collections.abc import Iterable, Sequence
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
)
from skfem.helpers import ddot, div, sym_grad

from eofm.elasticity.box import check_cells, deform_box, press_box
from eofm.elasticity.material import lame
from eofm.errors import InputError
from eofm.grid import FACES, Array, Edge, Grid, Mask, along_face, componentwise, unit_spacing
from eofm.io.limits import check_size
from eofm.settings import Forward, Sample

Spacing = tuple[float, ...]

# Sides of the elements of the true field of images and of volumes, px.
CELLS = {2: 1.0, 3: 3.0}
# Cells, along each side of a square, of the meshes of homogeneous samples; each is finer by
# RATIO. The last one is as large as a profile of motion that is rough ever gets.
RATIO = 1.5
MESHES = (16, 24, 36, 54, 81, 122)
# Memory that a cell takes in the factors of a square mesh of 400 x 400 cells, bytes.
CELL = 40_000
# Cells shrink towards the corners, where stress is singular, with this power of the distance:
# the rate of the elements is three, and displacements grow like r^0.6 and more.
GRADING = 3


def true_field(sample: Sample, forward: Forward = Forward()) -> Array:
    """Displacement of a sample with its inclusions.

    Parameters
    ----------
    sample : Sample
        Size, materials, inclusions, and how it is pressed.
    forward : Forward
        Size of the elements.

    Returns
    -------
    ndarray, shape (2, height, width) or (3, depth, height, width)
        In px; of volumes float32.

    Examples
    --------
    >>> import eofm
    >>> disc = eofm.Inclusion(x1=20, x2=15, radius=6, stiffness=5)
    >>> sample = eofm.Sample(height=30, width=40, compression=1.5, inclusions=(disc,))
    >>> u = eofm.true_field(sample)
    >>> bool(abs(u[:, 0]).max() < 1e-9), bool(abs(u[1, -1] + 1.5).max() < 1e-9)
    (True, True)
    """
    cell = forward.true_cell or CELLS[len(sample.shape)]
    return displacement(sample, cell)


def background_field(sample: Sample, forward: Forward = Forward()) -> Array:
    """The field u_bg of the same experiment without inclusions, eq. (Ansatz).

    Parameters
    ----------
    sample : Sample
        Size, materials and how it is pressed; its inclusions are not used.
    forward : Forward
        Largest estimated error.

    Returns
    -------
    ndarray, shape (2, height, width) or (3, depth, height, width)
        In px; of volumes float32.

    Examples
    --------
    >>> import eofm
    >>> u = eofm.background_field(eofm.Sample(height=30, width=40, compression=1.5))
    >>> u.shape
    (2, 30, 40)
    """
    return deform(sample, press(sample), error=forward.background_error)


def displacement(sample: Sample, cell: float) -> Array:
    """Displacement of a sample fixed on top and moved at the bottom.

    Parameters
    ----------
    sample : Sample
        Size, materials and motion of the bottom. Where its contact slips, the middle of the top
        stays where it is, or a volume as a whole neither moves sideways nor turns.
    cell : float
        Side of the biquadratic or triquadratic elements, px.

    Returns
    -------
    ndarray, shape (2, height, width) or (3, depth, height, width)
        ``u`` with ``-div sigma(u) = 0`` at the pixel centres, px.
    """
    check_size("the sample", (2, *sample.shape))
    if sample.depth is not None:
        return press_box(sample, press(sample), cell)
    return _solve(sample, press(sample), make_basis(sample, cell))


def deform(
    sample: Sample,
    motion: dict[Edge, Array],
    *,
    error: float = 1e-3,
    pixel_size: Sequence[float] = (1.0, 1.0, 1.0),
) -> Array:
    """Displacement of a homogeneous sample some of whose edges move in a known way.

    It is smooth but for the corners, so that meshes that are finer there need a number of
    cells that hardly grows with the pixels. They are refined until two of them agree.

    Parameters
    ----------
    sample : Sample
        Size and material, without inclusions; how it is pressed is stated by ``motion``.
    motion : dict of ndarray, shape (2, n) or (3, n, m)
        Displacement at points that divide an edge, or a face of a volume, evenly (n = 1:
        constant), px, NaN where it is free, as are the other edges. In a direction in which no
        edge is held, the middle of the first stays where it is, or a volume as a whole.
    error : float
        Largest error wanted, px, estimated for elements that converge with rate two at
        least. A motion that is rough from pixel to pixel is followed less closely, as far as
        the finest mesh goes.
    pixel_size : (lateral, axial, elevational)
        Sides of a pixel in any unit; of an image two count.

    Returns
    -------
    ndarray, shape (2, height, width) or (3, depth, height, width)
        At the pixel centres, px.

    Raises
    ------
    InputError
        If the edges of an image leave the sample free to turn.
    """
    check_size("the sample", (2, *sample.shape))
    sample = sample.changed(inclusions=())
    spacing = unit_spacing(pixel_size[: len(sample.shape)])
    if sample.depth is not None:
        return deform_box(sample, motion, error, spacing)
    coarse = np.full((2, *sample.shape), np.inf)
    for cells in MESHES:
        u = _solve(sample, motion, graded_basis(sample, cells, spacing), spacing)
        change = np.abs(u - coarse).max() / (RATIO**2 - 1)
        if max(change, _missed(u, motion)) <= error:
            break
        coarse = u
    return u


def press(sample: Sample) -> dict[Edge, Array]:
    """Motion of the edges of the experiment, px: top fixed, bottom moved up.

    Where the contact slips, it is known along their normals alone.
    """
    top = np.zeros((ndim := len(sample.shape), *[1] * (ndim - 1)))
    if sample.contact == "slip":
        top[[c for c in range(ndim) if c != FACES["top"].component]] = np.nan
    bottom = top.copy()
    bottom[1] = -sample.compression
    return {"top": top, "bottom": bottom}


def make_basis(sample: Sample, cell: float, spacing: Spacing = (1.0, 1.0)) -> Basis:
    """Biquadratic vector elements on a uniform mesh with cells of about ``cell``.

    Lengths are those of pixels with sides ``spacing`` = (lateral, axial).

    Raises
    ------
    InputError
        If they take more memory than there is.
    """
    lengths = Grid(sample.shape, spacing).lengths
    numbers = [max(2, round(length / cell)) for length in lengths]
    check_cells(numbers, CELL)
    return _basis(np.linspace(0, x, n + 1) for x, n in zip(lengths, numbers, strict=True))


def graded_basis(sample: Sample, cells: int, spacing: Spacing = (1.0, 1.0)) -> Basis:
    """The same elements, about ``cells`` times ``cells``, which shrink towards the corners."""
    lengths = Grid(sample.shape, spacing).lengths
    sides = []
    for length in lengths:
        t = np.linspace(0, 1, max(4, round(cells * length / np.sqrt(np.prod(lengths)))) + 1)
        sides.append(length * t**GRADING / (t**GRADING + (1 - t) ** GRADING))
    return _basis(sides)


def stiffness_matrix(basis: Basis, sample: Sample, spacing: Spacing = (1.0, 1.0)) -> sp.csr_array:
    """Matrix of the form ``int 2 mu eps(u):eps(v) + lambda div(u) div(v)``.

    The volumetric part uses 2 x 2 Gauss points (selective reduced integration), which
    keeps biquadratic elements free of locking as nu goes to 1/2 (Malkus and Hughes,
    Comput. Methods Appl. Mech. Eng. 15, 1978).
    """
    pixel = componentwise(spacing, 2)

    @BilinearForm
    def shear(u: Any, v: Any, w: Any) -> Any:
        return 2 * lame(sample, w.x / pixel)[1] * ddot(sym_grad(u), sym_grad(v))

    @BilinearForm
    def volume(u: Any, v: Any, w: Any) -> Any:
        return lame(sample, w.x / pixel)[0] * div(u) * div(v)

    reduced = Basis(basis.mesh, basis.elem, intorder=3)
    return shear.assemble(basis) + volume.assemble(reduced)


def solve_positive(A: sp.csr_array, b: Array, ordering: str = "MMD_AT_PLUS_A") -> Array:
    """Solve a symmetric positive definite sparse system.

    There is no need of pivots off the diagonal, which would fill the factors of graded
    meshes. An ordering from `_dissect` is ``NATURAL`` here.
    """
    options = {"SymmetricMode": True}
    lu = splu(A.tocsc(), permc_spec=ordering, diag_pivot_thresh=0.0, options=options)
    return lu.solve(b)


def _dissect(lines: NDArray[np.int64], some: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Nested dissection: both halves of a mesh before the line of nodes between them.

    ``lines``, shape (2, n), numbers the lines of nodes that hold each unknown; even ones are
    sides of cells. The time of a factorisation then grows with the power 3/2 of the unknowns,
    and it halves that of the minimum degree ordering on a mesh of 256 x 256 cells.
    """
    extent = np.ptp(lines[:, some], axis=1)
    line = lines[int(extent[1] > extent[0]), some]
    middle = (line.min() + line.max()) // 4 * 2
    if extent.max() < 6:
        return [some]
    return [
        *_dissect(lines, some[line < middle]),
        *_dissect(lines, some[line > middle]),
        some[line == middle],
    ]


def _solve(
    sample: Sample,
    motion: dict[Edge, Array],
    basis: Basis,
    spacing: Spacing = (1.0, 1.0),
) -> Array:
    """What `deform` returns, for elements on any mesh and any materials."""
    sides = np.reshape(spacing, (2, 1))
    pixels, nodes = Grid(sample.shape), _components(basis)
    # The smallest cells are larger than 1e-6 px.
    x = (basis.doflocs[:, nodes[0]] / sides).round(9)
    prescribed, held = basis.zeros(), np.zeros(x.shape, dtype=bool)
    for edge, g in motion.items():
        on = np.flatnonzero(FACES[edge].distance(x, pixels) == 0)
        other = 1 - FACES[edge].component
        there = along_face(g, x[other, on] / pixels.lengths[other])
        told = np.isfinite(there)
        for c in (0, 1):
            prescribed[nodes[c, on[told[c]]]] = sides[c] * there[c, told[c]]
            held[c, on] |= told[c]
    first = FACES[next(iter(motion))]
    along = x[1 - first.component] / pixels.lengths[1 - first.component]
    off = np.where(first.distance(x, pixels) == 0, np.abs(along - 0.5), np.inf)
    held[~held.any(1), off.argmin()] = True
    _check_held(x, held)
    K = stiffness_matrix(basis, sample, spacing)
    A, b, u, free = condense(K, x=prescribed, D=nodes[held])
    lines = np.stack([np.unique(c.round(9), return_inverse=True)[1] for c in basis.doflocs])
    order = np.concatenate(_dissect(lines[:, free], np.arange(len(free))))
    u[free[order]] = solve_positive(A[order][:, order], b[order], ordering="NATURAL")
    return _on_pixels(sample.shape, x, u[nodes] / sides)


def _check_held(x: Array, held: Mask) -> None:
    """Refuse what is held in so few directions that it may turn."""
    turn = np.stack([-x[1], x[0]])
    shifts = [np.broadcast_to(np.reshape(e, (2, 1)), x.shape) for e in np.eye(2)]
    if np.linalg.matrix_rank(np.stack([f[held] for f in (*shifts, turn)])) < 3:
        raise InputError(
            "the edges that are known leave the sample free to turn; say how another one moves"
        )


def _missed(u: Array, motion: dict[Edge, Array]) -> float:
    """Largest difference from the motion prescribed at the pixels of edges, px.

    Corners are left out: two edges may tear them apart.
    """

    def difference(edge: Edge, g: Array) -> Array:
        there = u[:, *FACES[edge].pixels()]
        return there - along_face(g, np.linspace(0, 1, there.shape[1]))

    inner = (np.abs(difference(edge, g)[:, 1:-1]) for edge, g in motion.items())
    return max(float(np.nanmax(d, initial=0.0)) for d in inner)


def _basis(sides: Iterable[Array]) -> Basis:
    return Basis(MeshQuad.init_tensor(*sides), ElementVector(ElementQuad2()), intorder=4)


def _components(basis: Basis) -> NDArray[np.int64]:
    """Degrees of freedom of u1 and of u2, in the same order of their nodes."""
    kinds = basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs
    return np.stack([np.concatenate([dofs[i] for dofs in kinds]) for i in (0, 1)])


def _on_pixels(shape: tuple[int, ...], x: Array, u: Array) -> Array:
    """Cubic splines through values on a tensor grid of nodes, at the pixel centres."""
    x1, x2 = (np.unique(c) for c in x)
    order = np.lexsort(x)
    rows, columns = (np.arange(n) for n in shape)
    return np.stack(
        [RectBivariateSpline(x2, x1, c[order].reshape(len(x2), len(x1)))(rows, columns) for c in u]
    )
