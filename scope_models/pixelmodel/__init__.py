"""The model of a star's pixels: its light, positions and widths, and its neighbors."""

__all__ = []
