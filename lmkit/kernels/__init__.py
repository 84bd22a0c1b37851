"""Compiled kernels: plain C, each defined by a numpy expression (docs/decisions/0013-compiled-kernels.md)."""
