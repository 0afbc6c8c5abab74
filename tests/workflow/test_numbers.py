"""Texts quote what the files of measured numbers say."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "workflow/scripts"))
import quote_numbers


def test_texts_and_numbers_agree():
    root = quote_numbers.ROOT
    texts = {str(p.relative_to(root)): p.read_text() for p in quote_numbers.texts()}
    assert "<!--rows: paper-->" in texts["README.md"]
    for name, text in texts.items():
        assert quote_numbers.filled(text) == text, f"{name}: run make numbers"


def test_no_quoted_number_begins_a_line_and_so_ends_a_paragraph():
    for path in quote_numbers.texts():
        lines = [line for line in path.read_text().splitlines() if line.startswith("<!--")]
        for line in lines:
            assert line.endswith("-->"), f"{path}: {line}"
            assert line.startswith("<!--rows: ") or not quote_numbers.MARK.match(line), line


def test_each_file_says_when_how_and_where():
    for path in (quote_numbers.ROOT / "docs/figures").glob("*.json"):
        assert {"date", "command", "machine", "values"} == set(quote_numbers.measured(path.stem))


def test_a_number_that_differs_is_put_right():
    right = quote_numbers.filled("off by <!--paper: bubbles.count .1f-->7<!--/--> px")
    assert right == "off by <!--paper: bubbles.count .1f-->200.0<!--/--> px"
    assert quote_numbers.filled(right) == right


def test_a_table_has_a_row_for_each_test():
    lines = quote_numbers.filled("<!--rows: paper--> <!--/-->").splitlines()
    assert len(lines) == 4 + len(quote_numbers.TESTS)
    assert len({line.count("|") for line in lines[1:-1]}) == 1


@pytest.mark.parametrize("key", ["paper: nothing", "nowhere: bubbles", "rows: nothing"])
def test_what_is_not_there_is_an_error(key):
    with pytest.raises((KeyError, OSError)):
        quote_numbers.filled(f"<!--{key}-->7<!--/-->")
