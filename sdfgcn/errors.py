"""The one exception that means "the user can fix this"."""


class SdfgcnError(Exception):
    """A mistake the user can mend, told in one sentence.

    The sentence says what is wrong, the value seen and what would work. The command `sdfgcn`
    prints it on stderr without a traceback and exits with code 1.
    """
