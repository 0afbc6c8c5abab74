"""
From files to results
=====================

What the command ``eofm sample`` does, in Python: read what files and words describe, analyse it,
and write fields, tables, figures and a page to a folder. The pair is that of the page
:doc:`/start`.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import tifffile

import eofm

folder = Path(tempfile.mkdtemp())
inclusion = eofm.Inclusion(x1=105, x2=70, radius=26, stiffness=5)
sample = eofm.Sample(height=120, width=180, compression=4, inclusions=(inclusion,))
images = eofm.make_phantom(eofm.true_field(sample), eofm.Phantom(count=1500, noise=0.02))
for name, image in zip(("before", "after"), images, strict=False):
    eofm.io.write_image(folder / f"{name}.tif", image)

# %%
# The keys are those of a row of ``samples.tsv`` and of the options of ``eofm sample``. The bottom
# moved up by 20 um, which are 4 px of 5 um; x2 points down, hence the sign.
pair = eofm.Pair(
    reference=folder / "before.tif",
    deformed=folder / "after.tif",
    lateral_size=5,
    axial_size=5,
    top="fixed",
    bottom="moved 0 -20 um",
)
scene = eofm.read_scene(pair)
results = eofm.analyse(*scene.frames, known=scene.known, sample=scene.sample, measures=pair)

# %%
# All files appear together, or none does. ``report.html`` is one page that explains the others;
# ``results.vti`` opens in ParaView, ``images.tif`` is what to lay results over, and
# ``eofm view mine`` shows all of it in napari: see :doc:`/howto/viewers`.
mine = folder / "mine"
mine.mkdir()
results.write(mine, pair.files, kinds=("png",))
for path in sorted(mine.iterdir()):
    print(f"{path.name:28} {path.stat().st_size:8} bytes")

# %%
# The strain, as it was written to ``strain.png``: the inclusion is strained less, and so are the
# layers at the plates, where the sample cannot bulge.
picture = plt.imread(mine / "strain.png")
fig = plt.figure(figsize=(picture.shape[1] / 110, picture.shape[0] / 110), layout="none")
fig.add_axes((0, 0, 1, 1)).imshow(picture)
fig.gca().axis("off")

# %%
# Fields are float TIFFs with a page for each component, which Fiji and any TIFF reader open.
u1, u2 = tifffile.imread(mine / "displacement_um.tif")
print(f"u2 from {u2.min():.1f} to {u2.max():.1f} um")
