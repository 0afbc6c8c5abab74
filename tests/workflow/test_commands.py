"""Options from settings, and the table of samples."""

import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

from eofm.errors import InputError
from eofm.settings import Estimation, Inclusion, Sample

sys.path.insert(0, str(Path(__file__).parents[2] / "workflow/scripts"))
from commands import options, read_samples, sample_files, sample_words
from tiled import counts, levels, numbers, tile_memory, tiled, voxels


def test_options_state_every_value():
    words = shlex.split(options(Estimation(method="paper", zero_edges=("top", "bottom"))))
    assert {f"--{name.replace('_', '-')}" for name in Estimation.model_fields} <= set(words)
    assert words[words.index("--alpha") + 1] == "0.8"
    assert words[words.index("--zero-edges") + 1 :][:2] == ["top", "bottom"]
    assert words[words.index("--local-window") + 1] == "none"
    disc = Inclusion(x1=5, x2=4, radius=2.5, stiffness=9)
    assert '{"x1": 5.0,' in options(Sample(height=9, width=12, inclusions=(disc,)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sample\tbotom\na\tfixed\n", "unknown column botom; did you mean bottom?"),
        ("name\nx\n", "unknown column name"),
        ("top\nfixed\n", "lacks the column sample"),
        ("sample\na b\n", "sample 'a b'"),
        ("sample\na\na\n", "sample a stands in it twice"),
        ("sample\na\n# a comment\nb\tfixed\n", "row 2 has more cells"),
        ("", "cannot be read as a table"),
    ],
)
def test_a_table_of_samples_that_cannot_be_used(tmp_path, text, message):
    path = tmp_path / "bad.tsv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_samples(str(path))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_row_becomes_options_and_files(tmp_path):
    image, edge = tmp_path / "before.tif", tmp_path / "bottom.csv"
    image.touch()
    edge.touch()
    path = tmp_path / "pairs.tsv"
    rows = [
        "sample\treference\tdeformed\tbottom\troi",
        f"mine\t{image}#2\tresults/after.tif\toutside moved {edge}\t0 0 70 45",
        f"# not\t{image}",
        "other\tnowhere.tif\t\tmoved 0 -2\t",
    ]
    path.write_text("\n".join(rows) + "\n")
    mine, other = read_samples(str(path)).values()
    assert sample_words(mine) == [
        f"--reference={image}#2",
        "--deformed=results/after.tif",
        f"--bottom=outside moved {edge}",
        "--roi=0 0 70 45",
    ]
    assert sample_files(mine) == [str(image), "results/after.tif", str(edge)]
    assert set(other) == {"reference", "bottom"}
    assert sample_files(other) == []


def test_jobs_of_a_volume_in_tiles_follow_its_row(tmp_path):
    np.save(tmp_path / "V.npy", np.zeros((64, 64, 64), np.uint8))
    row = {"reference": str(tmp_path / "V.npy"), "tiles": "4 4 2", "overlap": "8"}
    assert tiled({"a": row, "b": {}}) == {"a": row}
    assert counts(row) == (2, 4, 4)
    assert levels(row) == 2
    assert [len(numbers(row, level)) for level in (0, 1, 2)] == [32, 4, 1]
    # A tile of 16 x 16 x 32 with 8 on either side, or on one.
    assert voxels(row) == 32 * 32 * 40
    assert tile_memory(row) < tile_memory(row | {"tiles": "2 2 2"})
    assert counts(row | {"tiles": "2 x 2"}) == (1, 1, 1)
    assert levels(row | {"factor": "0.25"}) == 1
    assert voxels(row | {"reference": "nowhere.npy"}) > 0
