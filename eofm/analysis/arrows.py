"""Arrows of the motion of bubbles, of figures and of pages."""

import numpy as np
import pandas as pd

from eofm.grid import Array

# How often arrows may be enlarged, and how long they are then at most, as a part of the picture's
# width.
FACTORS, LONGEST = (1, 2, 5, 10, 20, 50), 0.12


def motions(bubbles: pd.DataFrame, most: int) -> Array:
    """Places and motions of some bubbles, shape (4, n), px: more arrows would hide the image."""
    shown = bubbles.iloc[:: max(1, -(-len(bubbles) // most))]
    return shown[["x1", "x2", "u1", "u2"]].to_numpy(float).T


def enlarged(u: Array, v: Array, width: float) -> int:
    """How often motions are to be enlarged that would be too short to see in a picture."""
    longest = float(np.hypot(u, v).max(initial=1e-9))
    return max((f for f in FACTORS if f * longest <= LONGEST * width), default=1)
