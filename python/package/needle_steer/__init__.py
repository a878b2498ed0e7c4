"""Steering of a flexible bevel-tip needle in tissue.

Units are SI and frames are World unless a name says otherwise; configurations carry their units in
the keys (``offset_mm``). Every function that takes ``config`` takes None (the defaults), a dict as
`config` returns it, or the path of a TOML file; ``set`` changes single keys by their dotted names.
"""

from ._campaign import Campaign, campaign
from ._core import VERSION, LawView
from ._errors import Error, InputError, InternalError
from ._run import Run, config, read_log, report, run, shape

__version__ = "0.1.0"

__all__ = [
    "VERSION",
    "Campaign",
    "Error",
    "InputError",
    "InternalError",
    "LawView",
    "Run",
    "campaign",
    "config",
    "read_log",
    "report",
    "run",
    "shape",
]
