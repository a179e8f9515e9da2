"""The site: how Sphinx makes it.  ``./dev docs`` builds it, by build_site.py."""

import logging
import re
import sys
import warnings
from pathlib import Path

here = Path(__file__).parent
sys.path.insert(0, str(here / "extensions"))

import dalembert  # noqa: E402

project = "dalembert"
author = "the authors of dalembert"
copyright = "the authors of dalembert; GPL-3.0-or-later"
version = release = dalembert.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_argparse_cli",
    "numpydoc",
    "myst_parser",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "catalogue",
    "headers",
    "mathml",
    "names",
    "palette",
    "wrapping",
]
exclude_patterns = ["_static"]
nitpicky = True
nitpick_ignore = [
    ("c:identifier", "size_t"), ("c:identifier", "uint64_t"),
    ("c:identifier", "dal__guards"),  # in family.h, and of the library alone
    ("c:identifier", "dal_series"),  # of generated code
    ("c:identifier", "dal_event_series"),
    ("c:identifier", "dal_variation_series"),
    ("c:identifier", "dal__polynomials"),
]

# ---- prose ----

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4
myst_dmath_double_inline = True
html_math_renderer = "mathml"
highlight_language = "none"
default_role = "obj"

# A part may be without pages yet.
logging.getLogger("sphinx.sphinx.directives.other").addFilter(
    lambda record: "toctree glob pattern" not in str(record.msg)
)



def prepare(app, name, source):
    """Put the texts of pictures on one line: MyST joins their lines without a space."""
    source[0] = re.sub(r"!\[[^\]]*\]\(", lambda found: found[0].replace("\n", " "), source[0])


def skip(app, what, name, member, skipped, options):
    """Leave out the fields of named tuples: the class lists them, and they say nothing more."""
    return True if type(member).__name__ == "_tuplegetter" else None


def setup(app):
    app.connect("source-read", prepare)
    app.connect("autodoc-skip-member", skip)


# ---- Python ----

autosummary_generate = False
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_typehints = "none"  # the docstrings say them in words
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
add_function_parentheses = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = c_maximum_signature_line_length = 96
toc_object_entries_show_parents = "hide"

# ---- the gallery: the scripts of examples/ ----

sphinx_gallery_conf = {
    "examples_dirs": str((here.parent / "examples").resolve()),
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "gallery.place",
    "image_scrapers": ("gallery.described",),
    "reference_url": {"dalembert": None},
    "backreferences_dir": None,
    "abort_on_example_error": True,
    "download_all_examples": False,
    "write_computation_times": False,
    "remove_config_comments": True,
    "thumbnail_size": (480, 280),
    "notebook_extensions": [],
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "matplotlib_animations": True,
}
warnings.filterwarnings("ignore", message=".*is non-interactive")

# ---- pages ----

html_theme = "pydata_sphinx_theme"
html_title = "dalembert"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # which browsers do not fetch from file://
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 7,
    "navbar_persistent": ["search-button"],
    "show_toc_level": 2,
    "secondary_sidebar_items": {"**": ["page-toc"], "index": [], "catalogue/index": []},
    "footer_start": ["copyright"],
    "footer_end": [],
    "article_footer_items": [],
    "search_as_you_type": False,
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": [], "catalogue/index": []}
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True
