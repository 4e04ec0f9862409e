"""The version of skincal."""

__version__ = "0.1.0"
