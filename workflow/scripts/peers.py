"""Other tools for the same task, each as a function of two images.

The images, or volumes, have intensities of about [0, 1], as `eofm.imaging.intensity.normalise`
returns them, and the result ``u``, shape (2, height, width) or (3, depth, height, width) in px, has
``I2(x + u(x)) = I1(x)`` with component 0 lateral and component 1 axial, as everywhere in eofm.

Each tool has one setting for all pairs: of several, the one with the least errors over
three pairs, dense speckle of 256 x 256 px with 5 % noise and a motion of 6 px, the paper's
phantom, and dense speckle with 5 % noise that moves as that phantom does. Those for volumes are in
VOLUMES: the best over two volumes of 64 x 64 x 64 px of the benchmark's speckle, with other seeds
and motions. Every tool runs on one thread: their times compare, and their results do not depend on
the machine's cores.
Libraries are imported where they are used, for most are optional: ``pip install '.[peers]'``.

pyxel-dic requires opencv-python, and the OpenCV with DeepFlow is opencv-contrib-python-headless:
both write the same folder, and the last one installed stays. Where DeepFlow is not found, install
the latter again (``pip install --force-reinstall --no-deps opencv-contrib-python-headless``).
"""

from collections.abc import Callable
from functools import partial
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import interpn

from eofm.imaging.splines import resize, resize_field

Array = NDArray[np.float64]

# Voxels between two nodes of al-dvc.
NODES = 8


def tvl1(I1: Array, I2: Array, attachment: float = 15.0, blur: float = 1.0) -> Array:
    """scikit-image's TV-L1.

    Its default attachment, and a Gaussian of 1 px before it: less attachment (5, 10) smooths
    better over noise but loses the motion between sparse bubbles, and without the Gaussian
    noise costs half as much again.
    """
    from skimage.registration import optical_flow_tvl1

    smooth = (ndimage.gaussian_filter(I, blur) for I in (I1, I2))
    return optical_flow_tvl1(*smooth, attachment=attachment, dtype=np.float64)[::-1]


def ilk(I1: Array, I2: Array, radius: int = 10) -> Array:
    """scikit-image's iterative Lucas-Kanade, with a Gaussian window of radius 10 px.

    Smaller windows (5, 7, 8) often see no bubble, larger ones (15) blur the inclusion.
    """
    from skimage.registration import optical_flow_ilk

    return optical_flow_ilk(I1, I2, radius=radius, gaussian=True, dtype=np.float64)[::-1]


def dis(I1: Array, I2: Array, finest_scale: int = 0, blur: float = 0.0) -> Array:
    """OpenCV's dense inverse search, preset medium, up to the full resolution.

    The preset's own finest scale is half of it, with errors up to 1.8 times as large. Denser
    patches, more variational iterations and a Gaussian before it gain nothing.
    """
    import cv2

    cv2.setNumThreads(1)
    flow = cv2.DISOpticalFlow_create(cv2.DISOpticalFlow_PRESET_MEDIUM)
    flow.setFinestScale(finest_scale)
    smooth = (ndimage.gaussian_filter(I, blur) if blur else I for I in (I1, I2))
    return _components(flow.calc(*map(_bytes, smooth), None))


def deepflow(I1: Array, I2: Array) -> Array:
    """OpenCV's DeepFlow (of opencv-contrib), which has no settings."""
    import cv2
    from cv2 import optflow

    cv2.setNumThreads(1)
    return _components(optflow.createOptFlow_DeepFlow().calc(_bytes(I1), _bytes(I2), None))


def elastix(I1: Array, I2: Array, knots: int = 16) -> Array:
    """B-splines of elastix, knots 16 px apart on the finest of 4 levels, mean squares.

    Its adaptive stochastic descent on a sixteenth of the pixels, but at least 2048, as a
    number that does not grow with the image would starve large ones. Knots 8 or 12 px apart
    follow the noise, 20 px gain where there is no inclusion only; a cubic interpolator, more
    samples or a bending energy gain nothing, L-BFGS on all pixels ends in false minima.
    """
    import itk

    settings = itk.ParameterObject.New()
    values = settings.GetDefaultParameterMap("bspline", 4)
    values["Registration"] = ["MultiResolutionRegistration"]
    values["Metric"] = ["AdvancedMeanSquares"]
    values["FinalGridSpacingInPhysicalUnits"] = [str(knots)]
    values["GridSpacingSchedule"] = ["8", "4", "2", "1"]
    values["MaximumNumberOfIterations"] = ["500"]
    values["NumberOfSpatialSamples"] = [str(max(2048, I1.size // 16))]
    values["MaximumStepLength"] = ["0.5"]
    settings.AddParameterMap(values)
    fixed, moving = (itk.image_from_array(I.astype(np.float32)) for I in (I1, I2))
    _, transform = itk.elastix_registration_method(
        fixed, moving, parameter_object=settings, log_to_console=False, number_of_threads=1
    )
    # It also writes a file, wherever it is told.
    with TemporaryDirectory() as folder:
        u = itk.transformix_deformation_field(moving, transform, output_directory=folder)
    return _components(np.asarray(u))


def demons(I1: Array, I2: Array, field: float = 2.5, update: float = 2.0) -> Array:
    """SimpleITK's fast symmetric demons on 4 levels, 100 iterations each.

    Gaussians of 2.5 px smooth the field and of 2 px its update: 1 to 2 px follow the noise,
    4 px lose the sparse bubbles. The diffeomorphic kind and more iterations gain nothing.
    """
    import SimpleITK as sitk  # noqa: N813 - its usual name

    def image(values: Array, vector: bool = False) -> sitk.Image:
        made = sitk.GetImageFromArray(np.asarray(values, np.float64), isVector=vector)
        made.SetSpacing([(n - 1) / (m - 1) for n, m in zip(I1.shape, shape, strict=True)][::-1])
        return made

    method = sitk.FastSymmetricForcesDemonsRegistrationFilter()
    method.SetNumberOfThreads(1)
    method.SetNumberOfIterations(100)
    method.SetStandardDeviations(field)
    method.SetSmoothUpdateField(True)
    method.SetUpdateFieldStandardDeviations(update)
    u = np.zeros((I1.ndim, *I1.shape))
    for level in (3, 2, 1, 0):
        shape = tuple(max(8, -(-n // 2**level)) for n in I1.shape)
        start = image(np.moveaxis(resize_field(u, shape), 0, -1), vector=True)
        moved = method.Execute(image(resize(I1, shape)), image(resize(I2, shape)), start)
        u = _components(sitk.GetArrayFromImage(moved))
    return u


def pyxel(I1: Array, I2: Array) -> Array:
    """Finite element image correlation of pyxel-dic: squares of 12 px, on 4 scales.

    Its regularisation has a length of 256, 128, 64 and at last 16 px; without one it finds nothing
    in such images. Squares of 8 or 16 px with twice these lengths are as good, larger squares
    and shorter lengths are not.
    """
    try:
        import pyxel as px
    except OSError as error:  # gmsh needs libraries of the system
        raise ImportError(error) from error

    reference, deformed = (px.Image(name) for name in ("reference", "deformed"))
    reference.pix, deformed.pix = 255 * I1, 255 * I2
    height, width = I1.shape
    mesh, camera = px.MeshFromROI(np.array([[0, 0], [width - 1, height - 1]]), [12, 12])
    mesh.Connectivity()
    images = reference, deformed, mesh, camera
    start = px.MultiscaleInit(*images, l0=32.0, disp=False)
    values, _ = px.Correlate(*images, l0=16.0, U0=start, disp=False)
    nodes = np.stack(camera.P(*mesh.n.T))
    moved = np.stack(camera.P(*(mesh.n + values[mesh.conn]).T))
    x1, x2 = (np.unique(x.round(6)) for x in nodes)
    order = np.lexsort(nodes.round(6))
    u = (moved - nodes).T[order].reshape(len(x2), len(x1), 2)
    return interpn((x2, x1), u, np.mgrid[:height, :width].T).T


def aldvc(I1: Array, I2: Array, subset: int = 16, step: int = NODES) -> Array:
    """Augmented Lagrangian digital volume correlation of al-dvc; NaN but at its nodes.

    Subsets of 16 voxels, as in the accuracy that it publishes.
    """
    from al_dvc import dvcpara_default, run_aldvc

    settings = dvcpara_default(
        winsize=subset, winstepsize=step, n_threads=1, backend="numba", verbose=False
    )
    found = run_aldvc(settings, [I1, I2], compute_strain=False)
    u = np.full((3, *I1.shape), np.nan)
    at = np.rint(found.dvc_mesh.coordinates).astype(int).T[::-1]
    u[:, *at] = found.result_disp[0].U.T
    return u


TOOLS: dict[str, Callable[..., Array]] = {
    tool.__name__: tool for tool in (tvl1, ilk, dis, deepflow, elastix, demons, pyxel)
}


# Those for volumes, with their settings.
VOLUMES: dict[str, Callable[..., Array]] = {
    "tvl1": partial(tvl1, attachment=5.0, blur=0.0),
    "ilk": partial(ilk, radius=7),
    "elastix": partial(elastix, knots=16),
    "demons": partial(demons, field=1.5, update=2.5),
    "aldvc": aldvc,
}


def estimate(tool: str, I1: Array, I2: Array, **setting: float) -> Array | None:
    """Displacement by the tool of a name; None where its library is not installed."""
    tools = TOOLS if I1.ndim == 2 else VOLUMES
    try:
        return tools[tool](I1, I2, **setting)
    except ImportError as error:
        print(f"{tool}: not installed ({error})")
        return None


def _bytes(I: Array) -> NDArray[np.uint8]:
    """The image with 8 bits, which is all that OpenCV's flows take."""
    return np.clip(255 * I, 0, 255).round().astype(np.uint8)


def _components(u: NDArray) -> Array:
    """A field with its components first instead of last."""
    return np.moveaxis(u, -1, 0).astype(np.float64)
