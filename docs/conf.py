"""How the documentation is built: ``sphinx-build -W -b html docs docs/_build/html``.

Notebooks and commands run during the build, so every output on a page is that of the code beside it. Set
``SKINCAL_DOCS_RUN=0`` to leave them out while writing.
"""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

from sphinx.application import Sphinx

import skincal

HERE = Path(__file__).parent

# Sphinx reads below its own folder only. The link is made here, as links do not survive every way to pass a tree on.
if not (HERE / "notebooks").exists():
    (HERE / "notebooks").symlink_to(Path("..") / "notebooks", target_is_directory=True)

RUN = os.environ.get("SKINCAL_DOCS_RUN", "1") != "0"

project = "skincal"
author = "The skincal developers"
project_copyright = author
version = release = skincal.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "sphinx_copybutton",
    "short_names",
    "modules",
    "runs",
    "verbs",
    "results",
    "presets",
    "effects",
]
exclude_patterns = ["_build", "**.ipynb_checkpoints"]

# Two hyphens begin an option; they are no dash.
smartquotes_action = "qe"

html_theme = "furo"
html_title = f"skincal {release}"
html_static_path = ["_static"]
html_css_files = ["skincal.css"]
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True

myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

# Equations have the number of their page before their own; MathJax comes with the pages, which need no network.
numfig = True
numfig_format = {"figure": "Figure %s"}
math_numfig = True
math_numsep = "."
math_eqref_format = "equation ({number})"

nb_execution_mode = "force" if RUN else "off"
nb_execution_timeout = 900
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True

runs_enabled = RUN
results_folder = str(Path(__file__).parent.parent / "benchmarks" / "results")

# Every cross reference must be found. The types of signatures may be those of other projects, and a value that a
# package passes on from its module is not on the page of the package.
nitpicky = True
nitpick_ignore_regex = [
    ("py:(class|obj)", ".*"),
    ("py:data", r"PHASES|.*\.[A-Z]+_(COLUMNS|NAMES)"),
    ("py:attr", "SkinResponse.status"),
]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_type_aliases = {
    name: name
    for name in (
        "ArrayLike",
        "BoolArray",
        "Bools",
        "Columns",
        "FloatArray",
        "Floats",
        "IntArray",
        "Interval",
        "Ints",
    )
}
autoclass_content = "class"
autosummary_generate = False
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False


def setup(app: Sphinx) -> None:
    """Says of an extension what it does not say itself: it copies files when the build is over."""
    app.extensions["sphinx-mathjax-offline"].parallel_read_safe = True
