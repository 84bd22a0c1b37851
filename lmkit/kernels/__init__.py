"""Compiled kernels: plain C beside the numpy expression that defines it (docs/decisions/0013-compiled-kernels.md)."""
