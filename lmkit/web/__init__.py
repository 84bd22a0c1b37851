"""The page of `lmkit web`: a local server over one project folder, and plain modules in the browser.

Every action calls the functions and pipelines behind the command line, or runs the command itself.
"""
