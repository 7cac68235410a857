"""The exception for mistakes of the user."""


class AbraceError(Exception):
    """Something that the user gave is wrong: the message says what, where, and what was expected.

    A node's `main` prints the message as one line and exits with code 2.
    """
