"""Thousands of recordings of a site: landmarks are detected once, then mapped, tracked and reported."""
