"""Every numeric option with extreme values: one clear line, or a result, within seconds."""

import faulthandler
import itertools
import os
import sys

import numpy as np
import pytest

from eofm import compiled
from eofm.app.cli import STEPS, main
from eofm.app.options import sections_of
from eofm.elasticity.forward import CELL, true_field
from eofm.errors import InputError
from eofm.io import limits
from eofm.settings import (
    Estimation,
    Forward,
    Identification,
    Pair,
    PartOfScale,
    Phantom,
    Sample,
    Tiling,
    Tracking,
    VirtualOct,
)
from eofm.simulation.phantom import make_phantom
from eofm.simulation.virtual_oct import DENSEST, fill, make_tomograms, widths

VALUES = ("nan", "1000000", "-1e30", "0", "1e30", "1e-30")
# No value may take longer; what does ends the tests.
SECONDS = 60
PAIR = ["{0}/a.tif", "{0}/b.tif"]
SIZE = ["--height", "16", "--width", "20", "--compression", "1"]
BEFORE_AND_AFTER = ["--reference", "{0}/o_a.tif", "--deformed", "{0}/o_b.tif"]
# The step that takes least time of those that take a section.
CHEAPEST = {
    Sample: ["forward", *SIZE, "--output", "{0}/o.tif"],
    Forward: ["background", *SIZE, "--output", "{0}/o.tif"],
    Phantom: ["phantom", "{0}/true.tif", *BEFORE_AND_AFTER, "--table", "{0}/o.csv", "--count", "9"],
    VirtualOct: ["virtual-oct", "{0}/true.tif", "{0}/true.tif", *BEFORE_AND_AFTER]
    + ["--truth", "{0}/o.tif", "--background", "{0}/o_bg.tif", "--reflectors", "9", "--scale", "1"],
    Tracking: ["track", *PAIR, "--output", "{0}/o.csv"],
    Estimation: ["estimate", *PAIR, "--output", "{0}/o.tif"],
    Identification: [
        "stiffness",
        *PAIR,
        *SIZE,
        "--cell",
        "8",
        "--output",
        "{0}/o.tif",
        "--displacement",
    ]
    + ["{0}/o_u.tif", "--iterations", "1", "--rounds", "1"],
    Pair: ["sample", "--reference", "{0}/a.tif", "--deformed", "{0}/b.tif", "--folder", "{0}/o"]
    + ["--figures", "none", "--error-bars", "0"],
    Tiling: ["coarse", "--reference", "{0}/a.tif", "--deformed", "{0}/b.tif", "--work", "{0}/o"]
    + ["--tiles", "1", "1", "1"],
    PartOfScale: ["tile", "{0}"],
}


def numeric(section):
    """Options of a section that hold numbers, and how many each."""
    for name, field in section.model_fields.items():
        kind = str(field.annotation)
        if "int" in kind or "float" in kind:
            several = 4 if name in ("roi", "extent") else 2
            yield f"--{name.replace('_', '-')}", several if section.takes_many(name) else 1


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("extremes")
    for words in (
        ["forward", *SIZE, "--output", "{0}/true.tif"],
        ["phantom", "{0}/true.tif", "--reference", "{0}/a.tif", "--deformed", "{0}/b.tif"]
        + ["--table", "{0}/o.csv", "--count", "60"],
    ):
        assert main([word.format(folder) for word in words]) == 0
    return folder


def outcome(words, capsys):
    """Status of a step, and what it says on standard error."""
    faulthandler.dump_traceback_later(SECONDS, exit=True, file=sys.__stderr__)
    try:
        status = main(words)
    except SystemExit as error:
        status = error.code
    finally:
        faulthandler.cancel_dump_traceback_later()
    return status, capsys.readouterr().err


def test_every_section_has_a_step_here():
    known = {s for step in STEPS for s in sections_of(step).values()}
    assert all(any(issubclass(c, s) for c in CHEAPEST) for s in known)


@pytest.mark.parametrize("section", CHEAPEST, ids=lambda section: section.__name__)
def test_extreme_values_are_refused_in_one_line_or_give_a_result(section, folder, capsys):
    step = [*(word.format(folder) for word in CHEAPEST[section]), "--threads=1"]
    options = [*numeric(section), ("--max-size", 1)]
    refused = 0
    values = VALUES if section is not Identification else VALUES[::4]  # it takes longest
    for (option, several), value in itertools.product(options, values):
        words = [*step, f"{option}={' '.join([value] * several)}"]
        status, said = outcome(words, capsys)
        assert status in (0, 1, 3), (words, said)
        assert said.count("\n") == 1 or (status != 1 and said.count("\n") <= 4), (words, said)
        assert "Traceback" not in said
        refused += status == 1
    assert refused >= len(options)  # nan


@pytest.mark.parametrize("value", [*VALUES, "1000000000000"])
def test_any_number_of_threads_is_refused_or_taken(value, folder, capsys):
    pair = [str(folder / name) for name in ("a.tif", "b.tif")]
    words = ["track", *pair, "--output", str(folder / "o.csv"), f"--threads={value}"]
    status, said = outcome(words, capsys)
    assert status == (0 if value.startswith("1000") else 1 if value == "0" else 2)
    lines = said.splitlines()
    assert status == 0 or lines[-1].startswith("eofm track: "), said
    assert compiled.use_threads(1) <= os.cpu_count()


def test_more_bubbles_than_pixels_and_scatterers_than_can_be_told_apart_are_refused():
    with pytest.raises(InputError, match="321 bubbles are more than the image has pixels"):
        make_phantom(np.zeros((2, 16, 20)), Phantom(count=321))
    assert len(make_phantom(np.zeros((2, 16, 20)), Phantom(count=320))[2]) == 320
    u, few = np.zeros((2, 16, 20)), {"scale": 1, "reflectors": 0}
    room = DENSEST * 19 * 15
    dense = room / (19 * 15) * np.pi * np.prod(widths(VirtualOct()))
    assert len(fill((16, 20), VirtualOct(density=dense * 0.999, **few)).x.T) > 0.99 * room
    with pytest.raises(InputError, match="scatterers with the reflectors"):
        fill((16, 20), VirtualOct(density=dense * 1.01, **few))
    with pytest.raises(InputError, match="scatterers with the reflectors"):
        make_tomograms(u, u, VirtualOct(scale=1, reflectors=10 * int(room)))


def test_elements_beyond_the_memory_and_samples_like_threads_are_refused(monkeypatch):
    sample = Sample(height=16, width=20, compression=1)
    monkeypatch.setattr(limits, "memory", lambda: 19 * 15 * CELL / limits.MOST)
    assert true_field(sample).shape == (2, 16, 20)
    with pytest.raises(InputError, match=r"21 x 17 elements take .* larger ones \(true_cell\)"):
        true_field(sample, Forward(true_cell=0.9))
    with pytest.raises(InputError, match="no side may be more than 500 times another"):
        Sample.parse({"height": 8, "width": 4001, "compression": 1}, "sample")
