"""Checked settings, and what every rule needs to state its command and its inputs."""

import os
import re
import sys
from functools import cache
from pathlib import Path

import eofm
import eofm.app.config
from eofm.errors import InputError
from eofm.settings import WARPING

# The checkout, also where another workflow has ours as a module.
CHECKOUT = Path(str(workflow.current_basedir)).parents[1]
SCRIPTS = Path(os.path.relpath(CHECKOUT / "workflow/scripts"))
sys.path.insert(0, str(SCRIPTS))
from commands import options, read_samples, sample_files, sample_words
from deploy import prefix
from imports import Sources
from parts import asked_memory, minutes, parts, size, step_memory
from runs import only_run
from tiled import before_tiles, numbers, tile_files, tile_memory, tile_minutes, tiled

# A step that ends with 3 has written a result that it says not to trust: the log says why, and
# what follows shows it.
shell.prefix(prefix(CHECKOUT, workflow.deployment_settings.deployment_method))

# The lock of the folder is held as long as this process lives.
LOCKS = []


onstart:
    if workflow.is_main_process:
        try:
            LOCKS.append(only_run(Path(".snakemake")))
        except InputError as error:
            sys.exit(str(error))


try:
    settings = eofm.app.config.Config.parse(config, "configuration")
    SAMPLES = read_samples(settings.samples)
except InputError as error:
    sys.exit(f"{error}; every key is explained in config/README.md")


# Where a site wants rules to run in one: --software-deployment-method apptainer.
container: settings.container


TESTS = list(settings.tests)
# Past the paper: the preset, and the preset with the identified sample's background.
OURS = ["5b", "6"]
ROWS = ["background", *TESTS, *OURS]
# Past the paper, motions are larger than the speckle, and I2 is warped by u.
WARPED = settings.estimation.changed(zero_edges=(), **WARPING)
# Test 5's parameters for images of which nothing else is known: standard optical flow.
IMAGES_ONLY = WARPED.changed(beta=0.0)

SOURCES = Sources(Path(os.path.relpath(Path(eofm.__file__).parent)), SCRIPTS)


@cache
def code(name):
    """Files behind a script NAME.py or a step of the command: editing one reruns a rule."""
    of = SOURCES.of_script if name.endswith(".py") else SOURCES.of_step
    return sorted(map(str, of(name)))


def test_figure(name, test):
    """A figure of a test, shown in the report."""
    return report(
        f"results/figures/{name}.png",
        caption="../report/figure_test.rst",
        category="Tests",
        labels={"figure": name, "test": test},
    )
