"""The regression of the logarithm of a flux: variances from the evidence, variability, outliers."""

__all__ = []
