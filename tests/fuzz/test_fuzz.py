"""All that was ever found stays mended, and a short run finds nothing new."""

from pathlib import Path

import fuzz
import numpy as np
import pytest

from eofm import io
from eofm.errors import InputError

CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_what_was_found_once_is_read_or_refused_in_one_line(path):
    read = io.read_bubbles if path.suffix == ".csv" else io.read_image
    try:
        assert np.isfinite(read(path)).all(axis=None)
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017, either is right
        assert "memory" not in str(error)  # noqa: PT017


@pytest.mark.slow
def test_a_short_run_finds_nothing(tmp_path):
    results, faults = fuzz.fuzz(range(3000), cores=1, seed=99, found=tmp_path)
    assert faults == []
    assert sum(results.values()) == 3000
    kinds = {kind for kind, _ in results}
    assert kinds == set(fuzz.SHARES)
    # Most damage is seen, and some does no harm: the files reach the readers.
    assert {outcome for _, outcome in results} >= {"read", "refused"}


def test_a_reader_that_crashes_or_hangs_is_found(tmp_path, monkeypatch):
    """The watch itself: were nothing ever found, it would tell nothing."""
    broken = tmp_path / "broken"
    broken.mkdir()
    said = [fuzz._outcome(".png", broken)]
    monkeypatch.setattr(fuzz, "read", lambda *_: 1 / 0)
    said.append(fuzz._outcome(".png", broken))
    assert [outcome for outcome, _ in said] == ["refused", "fault"]
    assert "ZeroDivisionError" in said[1][1]
