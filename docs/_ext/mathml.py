"""Render formulas as MathML, which browsers show without a script and without a network."""

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util.math import wrap_displaymath


def visit_math(translator, node):
    """Write a formula within a line."""
    translator.body.append(convert(node.astext(), display="inline"))
    raise nodes.SkipNode


def visit_displaymath(translator, node):
    """Write a formula on a line of its own, which scrolls where it is wider than the page."""
    text = node.astext()
    if "\\\\" in text or "&" in text:
        text = wrap_displaymath(text, None, numbering=False)
    formula = convert(text, display="block")
    translator.body.append(f'<div style="overflow-x: auto; margin: 1em 0">{formula}</div>')
    raise nodes.SkipNode


def setup(app):
    """Add the renderer to Sphinx."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_displaymath, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
