"""The model of a star's pixels: its light, positions and widths."""

__all__ = []
