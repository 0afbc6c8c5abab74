"""What `make docs` checks of the built site is found where it is wrong."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "docs"), str(ROOT / "docs/_ext")]
pytest.importorskip("sphinx", reason="the extra docs is not installed")
import check_site  # noqa: E402
import eofm_docs  # noqa: E402


def test_links_that_lead_nowhere_are_found(tmp_path):
    (tmp_path / "other.html").write_text('<h1 id="here">x</h1><img src="picture.png">')
    page = '<a href="other.html#here"></a><a href="https://example.org/x"></a>'
    page += '<a href="other.html#there"></a><a href="gone.html"></a><a href="#top"></a>'
    (tmp_path / "index.html").write_text(page)
    assert sorted(check_site.dead_links(tmp_path)) == [
        "index.html: #top has no such place",
        "index.html: gone.html does not exist",
        "index.html: other.html#there has no such place",
        "other.html: picture.png does not exist",
    ]


def test_examples_that_were_not_run_are_found(tmp_path):
    scripts = sorted(path.name for path in (ROOT / "docs/examples").glob("*.py"))
    assert len(scripts) >= 15
    assert list(check_site.missing_examples(tmp_path)) == [f"{s}: was not run" for s in scripts]


def test_functions_without_docs_are_found(tmp_path, monkeypatch):
    def lonely(u, v=1):
        """Do something.

        Parameters
        ----------
        u : ndarray
        """

    class Bare:
        pass

    bare = SimpleNamespace(__all__=["lonely", "Bare"], lonely=lonely, Bare=Bare)
    bare.io = SimpleNamespace(write_more=lambda path: None)
    monkeypatch.setattr(check_site, "eofm", bare)
    monkeypatch.setattr(check_site, "DOCS", tmp_path)
    record = tmp_path / "gallery/backreferences/backreferences_all.json"
    record.parent.mkdir(parents=True)
    record.write_text('{"eofm.other": ["plot_01"]}')
    page = "has no page; add it to docs/reference/api.md"
    assert list(check_site.undocumented(tmp_path)) == [
        f"eofm.lonely: {page}",
        "eofm.lonely: its docstring says nothing of v",
        "eofm.lonely: no example in docs/examples uses it",
        f"eofm.Bare: {page}",
        "eofm.Bare: has no docstring",
        f"eofm.io.write_more: {page}",
        "eofm.io.write_more: has no docstring",
        "eofm.io.write_more: its docstring says nothing of path",
    ]


def test_examples_run_again_after_an_edit_of_the_library(tmp_path):
    library, docs = tmp_path / "library", tmp_path / "docs"
    (docs / "_build").mkdir(parents=True)
    library.mkdir()
    (library / "a.py").write_text("x = 1")
    assert eofm_docs.changed_code(library, docs)
    (docs / eofm_docs.RECORD).write_text(eofm_docs.state(library))
    assert not eofm_docs.changed_code(library, docs)
    (library / "a.py").write_text("x = 2")
    assert eofm_docs.changed_code(library, docs)


def test_the_reference_of_the_command_has_every_step_and_option():
    page = eofm_docs.command_page()
    for text in ("## eofm estimate\n", "`--alpha VALUE`", "`--output FILE`", "## eofm sample\n"):
        assert text in page
