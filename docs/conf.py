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
sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("studies/paper", "studies")]

# Each has a section on the page on the command line.
COMMANDS = ("demo", "simulate", "inject", "detrend", "fit", "report", "benchmark", "score")

project = "scope_models"
author = "scope_models developers"
copyright = f"2026, {author}"  # noqa: A001 (Sphinx's name)
version = __version__
release = __version__

extensions = [
    "animation",
    "mathml",
    "notebooks",
    "tables",
    "matplotlib.sphinxext.plot_directive",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx_automodapi.automodapi",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["_build"]
default_role = "py:obj"

# Links within the package must work. Other packages' names are not linked, so that the build needs
# no network; nor are names of arguments.
nitpicky = True
nitpick_ignore_regex = [
    (r"py:.*", r"(astropy|collections|dataclasses|datetime|functools|lightkurve|matplotlib)\..*"),
    (r"py:.*", r"(np|numpy|pathlib|photutils)\..*"),
    (r"py:obj", r"[a-z_]+|ID"),
    # type hints; base classes that are not public
    (r"py:class", r"Model|SkyCoord|tuple\[float|abc.ABC|scope_models\.(\w+\.)*_.*"),
    (r"py:class", r"scope_models\.(\w+\.)*(SkyEffect|StarModel)"),
]

# Links to other packages need their inventories from the network: on where the site is published,
# and on request (SCOPE_MODELS_INTERSPHINX=1), so that the build works without one.
if os.environ.get("READTHEDOCS") or os.environ.get("SCOPE_MODELS_INTERSPHINX"):
    extensions.append("sphinx.ext.intersphinx")
    intersphinx_mapping = {
        "python": ("https://docs.python.org/3/", None),
        "numpy": ("https://numpy.org/doc/stable/", None),
        "scipy": ("https://docs.scipy.org/doc/scipy/", None),
        "astropy": ("https://docs.astropy.org/en/stable/", None),
        "photutils": ("https://photutils.readthedocs.io/en/stable/", None),
        "lightkurve": ("https://lightkurve.github.io/lightkurve/", None),
        "matplotlib": ("https://matplotlib.org/stable/", None),
    }

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
html_favicon = "_static/logo.svg"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_math_renderer = "mathml"
html_sidebars = {"index": [], "getting_started": [], "changelog": []}
html_theme_options = {
    "header_links_before_dropdown": 6,
    "logo": {"text": project, "image_light": "_static/logo.svg", "image_dark": "_static/logo.svg"},
    "navbar_persistent": ["search-button"],
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "show_nav_level": 2,
    "show_prev_next": True,
}


def run_command(words):
    """Return what a command of the command line prints."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        main(words)
    return text.getvalue()


def write_outputs(app):
    """Write what the pages include: help of the commands, the demonstration, the presets."""
    from presets import write_presets

    os.environ["COLUMNS"] = "80"
    folder = Path(app.srcdir) / "_generated"
    folder.mkdir(exist_ok=True)
    for command in ("", *COMMANDS):
        help_text = run_command([*command.split(), "--help"])
        (folder / f"help_{command}.txt").write_text(help_text, encoding="utf-8")
    demo = run_command(["demo", "--overwrite", "--output-dir", str(folder / "demo")])
    (folder / "demo.txt").write_text(demo, encoding="utf-8")
    write_presets(folder / "presets.csv")


def setup(app):
    """Connect what this file adds to Sphinx."""
    app.connect("builder-inited", write_outputs)
