# Licensed under a 3-clause BSD style license - see LICENSE
"""Models whose parameters are made per instance."""

from astropy.modeling import Parameter

__all__ = ["InstanceParameters", "described"]


class InstanceParameters:
    """
    Mixin of models whose number of parameters depends on their arguments.

    It stands before the astropy class among the bases. A subclass calls `make_parameters` before
    ``super().__init__``.
    """

    # Filled in by each instance.
    _param_names = ()

    def make_parameters(self, parameters):
        """
        Give this instance its own parameters, after those of its class.

        Parameters
        ----------
        parameters : sequence of `~astropy.modeling.Parameter`
            The parameters, with their names, in their order.
        """
        self._param_names = (*self._param_names, *(p.name for p in parameters))
        for parameter in parameters:
            parameter.model = self
            self.__dict__[parameter.name] = parameter

    @property
    def param_names(self):
        """Names of the parameters, in their order (tuple of str)."""
        return self._param_names


def described(name, description, **constraints):
    """Return a parameter of default 0 with a description."""
    return Parameter(name, default=0.0, description=description, **constraints)
