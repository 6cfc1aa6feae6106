"""The command line ``jaxgel``."""

from .command_line import main

__all__ = ["main"]
