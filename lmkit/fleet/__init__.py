"""Thousands of recordings of one site: detected once, surveyed into maps, tracked, reported."""
