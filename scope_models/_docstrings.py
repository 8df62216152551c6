"""Parts that several docstrings share."""

import inspect

__all__ = ["documented"]

# The first ones are made of those after them.
_SHARED = {
    "write": "{path}\n\n{written}",
    "draw": "{ax}\n\n{axes}",
    "path": """path : str or path-like
    The file; compressed if the name ends in .gz.
overwrite : bool, optional
    Whether a file that exists is replaced.""",
    "written": """Returns
-------
pathlib.Path
    The file.

Raises
------
OSError
    If the file exists and is not to be replaced, or cannot be written; what was there before is
    still there.""",
    "ax": """ax : matplotlib.axes.Axes, optional
    Where to draw; a new figure by default.""",
    "axes": """Returns
-------
matplotlib.axes.Axes
    The Axes.""",
    "draw_three": """axes : sequence of matplotlib.axes.Axes, optional
    Three Axes to draw into; a new figure by default.

Returns
-------
numpy.ndarray
    The three Axes.""",
}


def documented(**parts):
    """Decorate a function, or a class and its methods, with ``{name}`` for shared parts in docs.

    Of a function its documentation after the first paragraph is shared.
    """

    def complete(decorated):
        for item in (decorated, *(vars(decorated).values() if inspect.isclass(decorated) else ())):
            if item is decorated or inspect.isfunction(item):
                text = inspect.cleandoc(item.__doc__ or "") + "\n"
                for name, part in (_SHARED | parts).items():
                    whole = part if isinstance(part, str) else _after_summary(part)
                    text = text.replace(f"{{{name}}}", whole.strip())
                item.__doc__ = text
        return decorated

    return complete


def _after_summary(function):
    return (inspect.getdoc(function) or "").partition("\n\n")[2]
