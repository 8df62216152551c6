"""What a detector does to light and charge: noise, saturation and further effects."""

__all__ = []
