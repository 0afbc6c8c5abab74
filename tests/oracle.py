"""A direct solver, as an oracle for the multigrid one."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from eofm.flow.functional import Quadratic


def direct(F: Quadratic) -> NDArray[np.float64]:
    """Minimiser of F by a sparse factorisation, shape (2, height, width)."""
    lu = splu(F.a().tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return F.field(lu.solve(F.b()))
