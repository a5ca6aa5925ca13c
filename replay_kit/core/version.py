"""The version of replay-kit, which files record; here, because no room may import the top of the package, which names all of them."""

__version__ = "0.3.0"
