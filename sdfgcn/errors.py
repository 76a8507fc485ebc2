"""The exception for errors that the user can fix."""


class SdfgcnError(Exception):
    """An error that the user can fix, described in one sentence.

    The sentence says what is wrong, which value was given and what would work. The command `sdfgcn`
    prints it on stderr without a traceback and exits with code 1.
    """
