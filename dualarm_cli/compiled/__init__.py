"""The compiled functions: loops over so many small numbers that calling numpy for each would take longer than they do.

Each module here calls the functions of one file of `src`; `dualarm_cli.native` loads the library.
"""
