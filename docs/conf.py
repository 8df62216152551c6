"""Configuration of the documentation's build."""

import contextlib
import io
import os
import sys
from pathlib import Path

from scope_models import __version__
from scope_models.cli import main

os.environ["MPLBACKEND"] = "Agg"
sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "scope_models"
author = "scope_models developers"
copyright = f"2026, {author}"  # noqa: A001 (Sphinx's name)
version = __version__
release = __version__

extensions = [
    "mathml",
    "matplotlib.sphinxext.plot_directive",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx_automodapi.automodapi",
    "sphinx_copybutton",
]
exclude_patterns = ["_build"]
default_role = "py:obj"
nitpicky = False

# Reference
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
automodsumm_inherited_members = False
automodapi_toctreedirnm = "api"

# Figures, all made by the build
plot_formats = [("png", 150)]
plot_html_show_formats = False
plot_html_show_source_link = False
plot_include_source = True

# Prompts and outputs are not copied with the code
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

html_theme = "pydata_sphinx_theme"
html_title = f"{project} {release}"
html_static_path = ["_static"]
html_show_sourcelink = False
html_math_renderer = "mathml"
html_sidebars = {  # pages without pages below them
    name: []
    for name in (
        "changelog", "command_line", "development", "fitting", "getting_started", "index",
        "models", "motion", "pld", "signals", "target",
    )
}  # fmt: skip
html_theme_options = {
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
}


def write_help(app):
    """Write the help of each command to a file that the page on the command line includes."""
    os.environ["COLUMNS"] = "88"
    folder = Path(app.srcdir) / "_generated"
    folder.mkdir(exist_ok=True)
    for name in ("", "demo", "simulate", "detrend", "fit"):
        text = io.StringIO()
        with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
            main([*name.split(), "--help"])
        (folder / f"help_{name}.txt").write_text(text.getvalue(), encoding="utf-8")


def setup(app):
    """Connect what this file adds to Sphinx."""
    app.connect("builder-inited", write_help)
