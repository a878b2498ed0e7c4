"""Progress by tqdm's protocol: an object with ``update(n)`` and ``close()``."""

from contextlib import contextmanager

from ._errors import InputError


@contextmanager
def shown(progress, total, unit):
    """The meter that ``progress`` asks for, closed at the end; None for none.

    ``progress`` is None or False for none, True for tqdm, or a function called with ``total`` and
    ``unit`` that answers a meter, as ``tqdm.tqdm`` does.
    """
    if progress is None or progress is False:
        yield None
        return
    if progress is True:
        try:
            from tqdm.auto import tqdm as progress
        except ImportError as missing:
            raise InputError("progress=True needs the package tqdm: pip install tqdm") from missing
    meter = progress(total=total, unit=unit)
    try:
        yield meter
    finally:
        meter.close()
