"""The one exception type that a person is meant to read."""


class AbraceError(Exception):
    """Something that a person gave us is wrong: says what, where, and what was expected.

    A node's `main` prints the message as one line and exits with code 2.
    """
