"""How the site is built: `make docs`."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

from eofm_docs import changed_code  # noqa: E402

project = "eofm"
author = "the eofm developers"
copyright = author
version = release = version_of("eofm")

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "eofm_docs",
]
# What a run makes here, and what other pages include.
exclude_patterns = ["_build", "examples", "figures"]
templates_path = ["_templates"]
suppress_warnings = ["config.cache"]

# The library.
add_module_names = False
autosummary_generate = True
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_use_plots = False

# Texts, with the labels of the paper's equations.
myst_enable_extensions = ["amsmath", "attrs_block", "attrs_inline", "colon_fence", "deflist"]
myst_enable_extensions += ["dollarmath", "substitution"]
myst_heading_anchors = 3
math_number_all = False
mathjax3_config = {"tex": {"macros": {"R": r"\mathbb{R}", "grad": r"\nabla"}}}

# Examples. All of them run again after an edit of the library: they are tests of it.
sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": "/plot_",
    "within_subsection_order": "FileNameSortKey",
    "run_stale_examples": changed_code(HERE.parent / "eofm", HERE),
    "abort_on_example_error": True,
    "backreferences_dir": "gallery/backreferences",
    "doc_module": ("eofm",),
    "reference_url": {"eofm": None},
    "reset_modules": ("matplotlib", "eofm_docs.plain_look"),
    "capture_repr": (),
    "remove_config_comments": True,
    "show_signature": False,
    "show_memory": False,
    "plot_gallery": "True",
    "parallel": 2,
    "download_all_examples": False,
    "nested_sections": False,
    "min_reported_time": 3600,
    "thumbnail_size": (560, 300),
    "write_computation_times": False,
}

# Looks.
html_theme = "pydata_sphinx_theme"
html_title = "eofm"
html_static_path = ["_static"]
html_css_files = ["eofm.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "eofm"},
    "navbar_align": "content",
    "header_links_before_dropdown": 7,
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "navigation_with_keys": False,
    "pygments_light_style": "tango",
    "pygments_dark_style": "github-dark",
    "back_to_top_button": True,
}
html_sidebars = {"index": [], "start": []}
