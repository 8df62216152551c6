"""Parts that several docstrings share."""

import inspect

__all__ = ["documented"]


def documented(**parts):
    """Decorate a function or class whose docstring has ``{name}`` in the place of shared parts."""

    def complete(decorated):
        text = inspect.cleandoc(decorated.__doc__ or "") + "\n"
        for name, part in parts.items():
            text = text.replace(f"{{{name}}}", part.strip())
        decorated.__doc__ = text
        return decorated

    return complete
