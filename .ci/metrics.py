"""Count files, lines, private definitions and lint exceptions of one or more checkouts.

Run as ``python .ci/metrics.py [CHECKOUT ...]``; without an argument the checkout of this script.
A code line holds neither only a comment nor only a docstring, and is not blank. A private
definition that is used once has a single reference, by name, in the whole package.
"""

import ast
import re
import sys
import tokenize
from collections import Counter
from pathlib import Path

CONVERTERS = re.compile(r"_(plain\w*|numbers|native|values)$")
LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def docstring_lines(tree):
    """Return the numbers of the lines that belong to docstrings."""
    lines = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(
            node, clean=False
        ):
            lines.update(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return lines


def code_lines(path, tree):
    """Return how many lines of a file hold code."""
    with tokenize.open(path) as file:
        lines = {
            line
            for token in tokenize.generate_tokens(file.readline)
            if token.type not in LAYOUT
            for line in range(token.start[0], token.end[0] + 1)
        }
    return len(lines - docstring_lines(tree))


def count(checkout):
    """Return the figures of a checkout, by name."""
    paths = sorted((checkout / "scope_models").rglob("*.py"))
    texts = [path.read_text(encoding="utf-8") for path in paths]
    trees = [ast.parse(text) for text in texts]
    code = [code_lines(*pair) for pair in zip(paths, trees, strict=True)]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    defined = [
        node.name
        for node in nodes
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
        and node.name.startswith("_")
        and not node.name.endswith("__")
    ]
    used = Counter(node.id for node in nodes if isinstance(node, ast.Name))
    used.update(node.attr for node in nodes if isinstance(node, ast.Attribute))
    exceptions = [line for text in texts for line in text.splitlines() if "# noqa" in line]
    return {
        "files": len(paths),
        "lines": sum(len(text.splitlines()) for text in texts),
        "code lines": sum(code),
        "code lines per file": round(sum(code) / len(paths)),
        "files over 600 lines": sum(len(text.splitlines()) > 600 for text in texts),
        "private definitions": len(defined),
        "private, used once": sum(used[name] == 1 for name in defined),
        "definitions of _plain and the like": sum(bool(CONVERTERS.match(d)) for d in defined),
        "lint exceptions": len(exceptions),
        "private reaches (SLF001)": sum("SLF001" in line for line in exceptions),
    }


def main():
    """Print a table, one column per checkout."""
    here = Path(__file__).resolve().parents[1]
    columns = [count(Path(name)) for name in sys.argv[1:] or [here]]
    for name in columns[0]:
        print(f"{name:36}" + "".join(f"{column[name]:>10,}" for column in columns))


if __name__ == "__main__":
    main()
