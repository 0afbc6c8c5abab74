"""
Beside other tools
==================

scikit-image has two dense optical flows, and elastix registers images by B-splines. All of them
return the same kind of field; this is how to bring them to the same sign and order.
"""

import matplotlib.pyplot as plt
import numpy as np
from skimage.registration import optical_flow_ilk, optical_flow_tvl1

import eofm

inclusion = eofm.Inclusion(x1=75, x2=50, radius=18, stiffness=5)
sample = eofm.Sample(height=80, width=120, compression=3, inclusions=(inclusion,))
truth = eofm.true_field(sample)
before, after, _ = eofm.make_phantom(truth, eofm.Phantom(count=1200, noise=0.1, seed=3))
before, after = ((I - before.min()) / (before.max() - before.min()) for I in (before, after))

# %%
# scikit-image returns (rows, columns), so axial first: reversed, it is ours. Its settings here are
# those of ``workflow/scripts/peers.py``, the best of several on three pairs.
fields = {"eofm": eofm.estimate_displacement(before, after).u}
fields["ILK"] = optical_flow_ilk(before, after, radius=10, gaussian=True)[::-1]
fields["TV-L1"] = optical_flow_tvl1(before, after, attachment=15)[::-1]

# %%
# elastix maps points of the fixed image to the moving one, lateral first: with *before* as the
# fixed image its deformation field is u itself, but for the order of the axes.
try:
    import itk
except ImportError:
    print("elastix is not installed here (pip install 'eofm[peers]'); its column is left out")
else:
    parameters = itk.ParameterObject.New()
    values = parameters.GetDefaultParameterMap("bspline", 3, 16.0)
    values["Metric"] = ["AdvancedMeanSquares"]
    values["Registration"] = ["MultiResolutionRegistration"]
    parameters.AddParameterMap(values)
    images = [itk.image_from_array(I.astype(np.float32)) for I in (before, after)]
    _, transform = itk.elastix_registration_method(*images, parameter_object=parameters)
    field = itk.transformix_deformation_field(images[1], transform)
    fields["elastix"] = np.moveaxis(np.asarray(field), -1, 0).astype(float)

# %%
fig, axes = plt.subplots(1, len(fields), figsize=(9.5, 2.4), sharex=True, sharey=True)
for ax, (name, u) in zip(axes, fields.items(), strict=True):
    error = np.hypot(*(u - truth))
    shown = ax.imshow(error, cmap="magma", vmin=0, vmax=0.5)
    ax.set_title(f"{name}: mean error {error.mean():.3f} px")
fig.colorbar(shown, ax=axes, label="px", shrink=0.8)
