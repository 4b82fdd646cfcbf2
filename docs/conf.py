"""How Sphinx builds the site: `make docs`."""

import hashlib
import os
import sys
from functools import partialmethod
from pathlib import Path

from nbclient import NotebookClient

ROOT = Path(__file__).parents[1]
PACKAGES = ("narxcal", "data_prep", "training", "eval", "configs")


def code_hash() -> str:
    """Hash of all code and settings that a tutorial may run."""
    files = sorted(
        file
        for name in PACKAGES
        for kind in ("py", "toml")
        for file in ROOT.glob(f"{name}/**/*.{kind}")
    )
    found = hashlib.sha256()
    for file in files:
        found.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes())
    return found.hexdigest()[:16]


project = "narxcal"
author = "The narxcal developers"
extensions = ["myst_nb", "sphinx.ext.autodoc"]
exclude_patterns = ["_build"]
highlight_language = "text"

myst_heading_anchors = 3  # as the forge makes them

# Tutorials run once for each state of their text and of the code, each in a folder of its own.
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "docs/_build/executed" / code_hash())
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600
# A command's output arrives in pieces that end anywhere: myst-nb's own merging makes lines of them.
NotebookClient.__init__ = partialmethod(NotebookClient.__init__, coalesce_streams=True)
os.environ["PATH"] = os.pathsep.join((f"{sys.prefix}/bin", os.environ["PATH"]))

default_role = "code"  # docstrings have Markdown's `code`
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}

html_theme = "pydata_sphinx_theme"
html_title = "narxcal"
html_show_sourcelink = False
# All pages by section beside each page: the theme's own list shows those of one section alone, and
# none where the sections are captions of one page.
html_sidebars = {"**": ["globaltoc.html"]}
html_static_path = ["static"]
html_css_files = ["site.css"]
html_theme_options = {
    "navbar_center": [],
    "navbar_persistent": ["search-field"],
    "show_prev_next": True,
    "use_edit_page_button": False,
}
