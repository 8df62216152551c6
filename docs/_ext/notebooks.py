"""Jupyter notebooks of the tutorials, made from the doctests and the text of their pages."""

import re
import textwrap
from pathlib import Path

import nbformat
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

_PROMPT = re.compile(r"^ *(>>>|\.\.\.) ?")
_DIRECTIVE = re.compile(r"^( *)\.\. [\w-]+::.*\n((?:\1 +.*\n|\s*\n)*)", re.MULTILINE)
_COMMENT = re.compile(r"^\.\. (?![\w-]+::).*\n((?: +.*\n|\s*\n)*)", re.MULTILINE)
_HEADING = re.compile(r"^(\S.*)\n([=\-~^])\2{2,}$", re.MULTILINE)
_LEVELS = {"=": "#", "-": "##", "~": "###", "^": "###"}
_ROLE = re.compile(r":[\w:]+:`~?\.?([^`<]+?)(?: <[^>]+>)?`")
_LINK = re.compile(r"`([^`<]+?) <(https?://[^>]+)>`_")


def make_notebook(text):
    """Return the notebook of a page: its text, and the code of its doctests."""
    cells, prose, code = [], [], []

    def finish(lines, make):
        content = "\n".join(lines).strip("\n")
        if content.strip():
            cells.append(make(content))
        lines.clear()

    for line in _flattened(text).splitlines():
        if _PROMPT.match(line):
            finish(prose, _markdown_cell)
            code.append(_PROMPT.sub("", line))
        elif code and line.strip():
            continue  # what the code prints
        else:
            finish(code, new_code_cell)
            prose.append(line)
    finish(prose, _markdown_cell)
    finish(code, new_code_cell)
    notebook = new_notebook(cells=cells)
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"  # the same file from the same page
    return notebook


def _flattened(text):
    """Return a page without directives; the code within them stays."""

    def keep_code(found):
        body = textwrap.dedent(found[2])
        lines = body.splitlines()
        first = next((i for i, line in enumerate(lines) if _PROMPT.match(line)), None)
        return "\n" + "\n".join(lines[first:]) + "\n\n" if first is not None else "\n"

    return _DIRECTIVE.sub(keep_code, _COMMENT.sub("\n", text))


def _markdown_cell(text):
    """Return a cell of text, from reStructuredText."""
    text = _HEADING.sub(lambda found: f"{_LEVELS[found[2]]} {found[1]}", text)
    text = _LINK.sub(r"[\1](\2)", text)
    text = _ROLE.sub(r"`\1`", text)
    return new_markdown_cell(text.replace("``", "`"))


def _write_notebooks(app):
    """Write the notebooks of all tutorials where the pages link them."""
    folder = Path(app.srcdir) / "_generated" / "notebooks"
    folder.mkdir(parents=True, exist_ok=True)
    for page in (Path(app.srcdir) / "tutorials").glob("*.rst"):
        notebook = make_notebook(page.read_text(encoding="utf-8"))
        if any(cell.cell_type == "code" for cell in notebook.cells):
            nbformat.write(notebook, folder / f"{page.stem}.ipynb")


def _add_link(app, docname, source):
    """Add the link to the notebook to the end of a tutorial."""
    folder, _, name = docname.rpartition("/")
    if (
        folder == "tutorials"
        and (Path(app.srcdir) / "_generated" / "notebooks" / f"{name}.ipynb").exists()
    ):
        source[0] += (
            f"\n\n:download:`Download this page as a notebook "
            f"<../_generated/notebooks/{name}.ipynb>`.\n"
        )


def setup(app):
    """Connect the notebooks to the build."""
    app.connect("builder-inited", _write_notebooks)
    app.connect("source-read", _add_link)
    return {"parallel_read_safe": True}
