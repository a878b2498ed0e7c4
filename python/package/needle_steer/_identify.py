"""One's own needle from recordings, and the paper's experiments."""

import json
import os

from . import _core
from ._progress import shown


def _files(files):
    return [files] if isinstance(files, (str, os.PathLike)) else list(files)


def estimate(files, config=None, *, set=None):
    """Stiffness, tip load and natural curvature of one's own needle from recorded insertions.

    Parameters
    ----------
    files : path or list of path
        Logs of runs, or tables of base poses and what was seen of the needle.
    config : dict or path, optional
        Needle and entry for tables.
    set : dict, optional
        Values by dotted keys.

    Returns
    -------
    found : dict
        As ``needle-steer estimate --json`` prints it.
    config : dict
        The configuration with what was found; `run` takes it.
    """
    return _core.estimate(_files(files), config, set)


def validate(files, config=None, *, set=None, html=None):
    """Predictions of recorded steps against what was measured.

    Parameters
    ----------
    files : path or list of path
        Tables of recordings, or logs of runs.
    config : dict or path, optional
        Needle, tissue and entry, as `estimate` answers them.
    set : dict, optional
        Values by dotted keys.
    html : path, optional
        A page with the curves.

    Returns
    -------
    dict
        As ``needle-steer validate --json`` prints it.
    """
    return _core.validate(_files(files), config, set, html)


def reproduce(
    experiments=("e1", "e2", "e3", "e4"),
    *,
    law="paper",
    runs=20,
    seed=1,
    phantom="paper",
    sensor=None,
    brackets=False,
    jobs=None,
    set=None,
    progress=None,
):
    """The paper's four experiments over seeds.

    Parameters
    ----------
    experiments : sequence of str, optional
        Some of e1, e2, e3, e4.
    law : str, optional
        Of the controlled experiments e2 and e4.
    runs, seed : int, optional
        Runs of each experiment, and the first seed.
    phantom, sensor : str, optional
        Preset of the phantom, and what closes the loop.
    brackets : bool, optional
        Add no control, an oracle, and the controller's model as plant.
    jobs : int, optional
        Threads; all cores by default.
    set : dict, optional
        Values by dotted keys, of every run.
    progress : bool or callable, optional
        See `run`.

    Returns
    -------
    dict
        As ``needle-steer reproduce --json`` prints it.
    """
    overrides = [f"{key}={json.dumps(value)}" for key, value in (set or {}).items()]
    with shown(progress, None, "run") as meter:
        step = (lambda: meter.update(1)) if meter is not None else None
        return _core.reproduce(
            list(experiments),
            law,
            runs,
            seed,
            phantom,
            sensor,
            overrides,
            brackets,
            jobs or os.cpu_count() or 1,
            step,
        )
