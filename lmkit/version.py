"""The one place that states lmkit's version."""

__version__ = "0.1.0"
