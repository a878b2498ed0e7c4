"""Steering of a flexible bevel-tip needle in tissue.

Units are SI and frames are World unless a name says otherwise; configurations carry their units in
the keys (``offset_mm``). Every function that takes ``config`` takes None (the defaults), a dict as
`config` returns it, or the path of a TOML file; ``set`` changes single keys by their dotted names.
"""

from importlib.util import find_spec as _find_spec

from ._campaign import Campaign, campaign
from ._chain import Chain
from ._core import VERSION, LawView, NeedleModel, Phantom
from ._errors import Error, InputError, InternalError
from ._identify import estimate, reproduce, validate
from ._run import Run, config, read_log, report, run, shape
from ._vision import Tracker, calibrate_stereo

if _find_spec("gymnasium") is not None:
    from . import gym as _gym  # registers the environment

__version__ = "0.1.0"

__all__ = [
    "VERSION",
    "Campaign",
    "Chain",
    "Error",
    "InputError",
    "InternalError",
    "LawView",
    "NeedleModel",
    "Phantom",
    "Run",
    "Tracker",
    "calibrate_stereo",
    "campaign",
    "config",
    "estimate",
    "read_log",
    "report",
    "reproduce",
    "run",
    "shape",
    "validate",
]
