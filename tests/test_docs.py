"""The documentation: every figure has a text, every block of code runs, every command exists."""

import ast
import doctest
import importlib
import re
import shlex
import textwrap

import pytest
from astropy.table import Table

from scope_models.cli._main import _make_parser

IMAGE = re.compile(r"^( *)\.\. (?:image|figure|plot)::(.*)\n((?:\1 +\S.*\n|\s*\n)*)", re.MULTILINE)

# Pages with scripts for the queue of a cluster, which no test can run.
NEEDS_A_CLUSTER = {"many_files.rst"}


def pages(repository):
    """Return the text of every page, by its name."""
    folder = repository / "docs"
    made_by_the_build = {"_build", "_generated", "api"}
    paths = [p for p in folder.rglob("*.rst") if not made_by_the_build & set(p.parts)]
    assert paths
    return {path.relative_to(folder).as_posix(): path.read_text(encoding="utf-8") for path in paths}


def blocks(text, language):
    """Return the blocks of code of a language, without their indentation."""
    found = re.findall(
        rf"^( *)\.\. code-block:: {language}\n((?:\1 +.*\n|\s*\n)*)", text, re.MULTILINE
    )
    return [textwrap.dedent(block) for _, block in found]


def test_figures_have_a_text(repository):
    missing = [
        f"{name}: {target.strip() or 'plot'}"
        for name, text in pages(repository).items()
        for _, target, options in IMAGE.findall(text)
        if not re.search(r":alt: +\S{3,}|:nofigs:", options)
    ]
    assert missing == []


def test_no_python_that_nothing_runs(repository):
    # Doctests run in pytest and figures in the build; a bare block of code would run nowhere.
    bare = {name for name, text in pages(repository).items() if blocks(text, "python")}
    assert bare <= NEEDS_A_CLUSTER


@pytest.mark.parametrize("name", sorted(NEEDS_A_CLUSTER))
def test_python_for_clusters(repository, name):
    text = (repository / "docs" / name).read_text(encoding="utf-8")
    for block in blocks(text, "python"):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("scope_models"):
                module = importlib.import_module(node.module)
                assert [item.name for item in node.names if not hasattr(module, item.name)] == []


def commands(repository):
    """Return the lines of the pages' shell blocks that call our command line."""
    texts = [
        block
        for text in pages(repository).values()
        for block in blocks(text, "bash") + blocks(text, "console")
    ]
    readme = (repository / "README.md").read_text(encoding="utf-8")
    texts += re.findall(r"^```bash\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    lines = "\n".join(texts).replace("\\\n", " ").splitlines()
    parts = [part.strip() for line in lines for part in line.split("&&")]
    return [part[part.index("scope-models ") :] for part in parts if "scope-models " in part]


def test_commands_exist(repository):
    parser = _make_parser()
    found = commands(repository)
    assert len(found) >= 4
    for line in found:
        words = shlex.split(re.sub(r"\$\w+", "1", line), comments=True)[1:]
        try:
            parser.parse_args(words)
        except SystemExit as error:
            if error.code != 0:  # --help and --version end with 0
                pytest.fail(f"the documented command is not accepted: {line}")


@pytest.fixture
def make_notebook(repository, monkeypatch):
    """Return the function that turns a tutorial into a notebook, or skip without nbformat."""
    pytest.importorskip("nbformat")
    monkeypatch.syspath_prepend(repository / "docs" / "_ext")
    return importlib.import_module("notebooks").make_notebook


def test_notebooks_hold_the_code_of_the_tutorials(repository, make_notebook):
    import nbformat

    for path in (repository / "docs" / "tutorials").glob("*.rst"):
        text = path.read_text(encoding="utf-8")
        notebook = make_notebook(text)
        nbformat.validate(notebook)
        code = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "code")
        ast.parse(code)
        examples = doctest.DocTestParser().get_examples(text)
        assert code.splitlines() == "".join(example.source for example in examples).splitlines()
        prose = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
        assert ">>>" not in prose
        assert not re.search(r"^\.\. ", prose, re.MULTILINE)


def test_stored_tables_can_be_read(repository):
    paths = sorted((repository / "docs/data").glob("*.ecsv"))
    assert paths
    for path in paths:
        assert len(Table.read(path)) > 0, path
