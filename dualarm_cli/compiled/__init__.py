"""Bindings of the compiled functions: loops over small numbers that would be slow in numpy.

Each module calls the functions of one file or group of files in `src`; `dualarm_cli.native` loads the library.
"""
