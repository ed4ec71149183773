"""Sphinx: pages in MyST Markdown that build.py lays out, and the API from the docstrings."""

import dynocal

project = "dynocal"
author = "The dynocal developers"
project_copyright = "The dynocal developers"
version = release = dynocal.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
# A page may begin a part below its first level, and code may be of a language that nobody colours.
suppress_warnings = ["misc.highlighting_failure", "myst.header"]
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
napoleon_google_docstring = False
html_theme = "furo"
html_title = "dynocal"
html_copy_source = False
html_show_sphinx = False
