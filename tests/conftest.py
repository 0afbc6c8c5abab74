"""Small samples that the tests share."""

import os

# The command sets this for its own process, which here is that of all tests; numba reads it
# again whenever it compiles, and does not let it change.
os.environ.setdefault("NUMBA_NUM_THREADS", "2")

import numpy as np
import pytest
from hypothesis import settings

import eofm
from eofm import threads
from eofm.compiled import use_threads

# As the command does: the processes of the tests take all cores as it is, and BLAS in each would
# take all of them once more.
threads.use_threads(None)

# The same examples in every run, on machines of any speed.
settings.register_profile("eofm", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("eofm")


# Files that take longest, in this order: none is to be left to one of several processes at the
# end. The second waits for Slurm while the first takes all cores.
LONGEST = ["test_workflow", "test_slurm", "test_runs", "test_volumes_in_tiles", "test_analyse"]
LONGEST += ["test_weight", "test_multigrid", "test_estimate_volumes", "test_forward"]
LONGEST += ["test_robust", "test_extremes", "test_faults", "test_stiffness", "test_box"]
LONGEST += ["test_page", "test_steps", "test_choice", "test_cli", "test_figures"]


def pytest_collection_modifyitems(items):
    rank = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))


@pytest.fixture(autouse=True)
def same_threads():
    """What a step takes, it takes for the whole process: not for the tests after it."""
    before = use_threads(2)
    yield
    use_threads(before)


@pytest.fixture(scope="session")
def sample():
    """A small sample with a stiff inclusion."""
    inclusion = eofm.Inclusion(x1=40, x2=36, radius=14, stiffness=6)
    return eofm.Sample(
        height=61, width=90, poisson_ratio=0.48, compression=2.5, inclusions=(inclusion,)
    )


@pytest.fixture(scope="session")
def truth(sample):
    return eofm.true_field(sample)


@pytest.fixture(scope="session")
def background(sample):
    return eofm.background_field(sample)


@pytest.fixture(scope="session")
def pair(truth):
    """Images before and after, and the true bubbles."""
    return eofm.make_phantom(truth, eofm.Phantom(count=90, seed=3))


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def speckle(shape, rng, blur=1.5):
    """A smooth random image in [0, 1]."""
    from scipy import ndimage

    I = ndimage.gaussian_filter(rng.normal(size=shape), blur, mode="wrap")
    return (I - I.min()) / np.ptp(I)
