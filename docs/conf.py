"""Sphinx: the site of the documentation (docs/decisions/0016-docs-site.md).

uv run --group docs sphinx-build -W --keep-going docs build/docs
"""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_extensions"), str(HERE.parent)]

from lmkit.version import __version__

project = "lmkit"
author = "The lmkit authors"
copyright = "The lmkit authors, Apache-2.0"
version = release = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "command_reference",
    "api_reference",
    "repository_links",
]
suppress_warnings = ["ref.python"]  # attributes of several classes share names

myst_enable_extensions = ["colon_fence", "deflist", "fieldlist"]
myst_heading_anchors = 4

# Notebooks are stored without results and run by every build.
nb_execution_mode = "force"
nb_execution_timeout = 60
nb_execution_in_temp = True
nb_execution_show_tb = True  # a failing cell is a warning, and warnings are errors
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = f"lmkit {__version__}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
highlight_language = "text"
smartquotes = False  # options begin with two hyphens
toc_object_entries_show_parents = "hide"
pygments_style = "default"
pygments_dark_style = "github-dark"
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
