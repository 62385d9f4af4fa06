"""The C++ core (``native/``): what is done for every pixel of every particle.

Functions release the interpreter lock, change none of their arguments, and check them: an array of
another type, shape or order of elements than described is a ``TypeError`` or ``ValueError`` whose
one line names the argument. Arrays have to be in C order. Results do not depend on threads.
"""

def instruction_set() -> str:
    """Name of the processor's level, of those that the core is compiled for.

    ``x86-64-v3`` or ``x86-64-v4``, or ``baseline`` for what every processor can do.
    """
