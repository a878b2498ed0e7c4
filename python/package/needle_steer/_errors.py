"""What can go wrong."""


class Error(Exception):
    """Any failure of this package; the message says what and where."""


class InputError(Error, ValueError):
    """An argument, a configuration or a file that cannot be used; the message has the remedy."""


class InternalError(Error, RuntimeError):
    """A fault of the package itself, named; nothing moves any more. Please report it."""
