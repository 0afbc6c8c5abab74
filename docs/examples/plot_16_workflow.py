"""
Your own step in the workflow
=============================

Another question, asked of every pair of a study: by how much does the sample turn? A rule of your
own reads what the steps of ``eofm`` write, and Snakemake runs it again only where something has
changed.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import eofm

folder = Path(tempfile.mkdtemp())
inclusion = eofm.Inclusion(x1=40, x2=40, radius=16, stiffness=6)
sample = eofm.Sample(height=70, width=100, compression=2.5, inclusions=(inclusion,))
pair = eofm.make_phantom(eofm.true_field(sample), eofm.Phantom(count=800))[:2]
for name, image in zip(("before", "after"), pair, strict=True):
    eofm.io.write_image(folder / f"{name}.tif", image)

# %%
# Two rules: the step ``eofm estimate`` as it is, and a script of four lines.
(folder / "turn.py").write_text("""\
import numpy as np, tifffile
u1, u2 = tifffile.imread(snakemake.input[0])
turn = (np.gradient(u2, axis=1) - np.gradient(u1, axis=0)) / 2
tifffile.imwrite(snakemake.output[0], np.degrees(turn).astype("float32"))
""")
(folder / "Snakefile").write_text("""\
rule turn:
    input: "displacement.tif"
    output: "turn.tif"
    script: "turn.py"

rule estimate:
    input: "before.tif", "after.tif"
    output: "displacement.tif"
    shell: "eofm estimate {input} --output {output}"
""")
environment = {"PATH": f"{Path(sys.executable).parent}:/usr/bin:/bin", "HOME": str(folder)}
command = [sys.executable, "-m", "snakemake", "--cores", "1", "--quiet", "all"]
subprocess.run(command, cwd=folder, check=True, env=environment, capture_output=True)

# %%
turn = eofm.io.read_image(folder / "turn.tif")
fig, ax = plt.subplots(figsize=(5.5, 3))
shown = ax.imshow(turn, cmap="RdBu_r", vmin=-4, vmax=4)
fig.colorbar(shown, label="degrees, clockwise", shrink=0.8)
ax.set_title("rotation of the material")
print(f"turned by up to {np.abs(turn).max():.1f} degrees")
