"""Forward models of moving stars on telescope pixels, and corrections and fits with them."""

import lazy_loader

# `__init__.pyi` lists the public names. They are imported at first use, because astropy.modeling
# and packages that need it import more slowly than a command line should answer.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
