"""The functions of `import lmkit`: paths and arrays in, results out.

Each function is the command of the same name (`lmkit locate`, `lmkit.locate`), and calls the same code.
"""
