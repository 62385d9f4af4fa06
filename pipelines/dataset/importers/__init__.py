"""Recordings in other programs' layouts: one module a layout, each ending in a ``Recording``.

What all of them share is in ``recording`` (what was read), ``settings`` (the options),
``recognition`` (which layout is it?) and ``placing`` (writing the files of a data set). COLMAP
models are read one floor above, where COLMAP's files are known.
"""
