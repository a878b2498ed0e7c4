"""Single insertions."""

import html
import json
import os
from collections.abc import Mapping

from . import _core
from ._errors import InputError
from ._progress import shown


def config(config=None, *, set=None):
    """A checked configuration with every key.

    Parameters
    ----------
    config : dict or path, optional
        Tables and keys that differ from the defaults, or a TOML file of them.
    set : dict, optional
        Values by dotted keys, for instance ``{"target.offset_mm": 5}``; they win.

    Returns
    -------
    dict
        Nested tables; units stand in the keys. Change it and hand it to any function that takes
        ``config``.

    Raises
    ------
    InputError
        An unknown key (with the nearest known one) or a value outside its range.
    """
    return _core.make_config(config, set)


class Run:
    """One insertion, as it ended.

    Attributes
    ----------
    summary : dict
        Verdict and figures, exactly those of ``needle-steer run --json``; lengths in millimetres. None
        for the log of a run that was killed.
    series : dict
        The columns of ``series.csv``: arrays (steps,) of numbers, NaN where the file has an empty
        field, and lists of words (``mode``, ``limits``). Units stand in the names.
    config : dict
        The configuration of the run.
    complete : bool
        Whether the log that it was read from is whole; True for a run of one's own.
    """

    def __init__(self, summary, series, config, complete=True, log=None):
        self.summary = summary
        self.series = series
        self.config = config
        self.complete = complete
        self._log = log if log is not None else (summary or {}).get("log")

    @property
    def ended(self):
        """The verdict in words; None for a run that was killed."""
        return self.summary["ended"] if self.summary else None

    def report(self, path):
        """Writes an HTML page of the run to ``path``, from its log.

        Raises
        ------
        InputError
            The run left no log: it was called without ``out``.
        """
        if self._log is None:
            raise InputError("this run left no log to report on: give run(..., out=FOLDER)")
        _core.report(self._log, path)

    def plot(self):
        """Four charts over time: errors, base, stiffness, displacement. Needs matplotlib.

        Returns
        -------
        matplotlib.figure.Figure
        """
        try:
            from matplotlib.figure import Figure
        except ImportError as missing:
            raise InputError(
                "plot() needs matplotlib: pip install 'needle_steer[plot]'"
            ) from missing
        charts = [
            ("distance from the tip axis [mm]", ["lateral_error_mm", "true_lateral_error_mm"]),
            ("base from its start [mm]", ["base_x_mm", "base_y_mm", "base_z_mm"]),
            ("stiffness [N/m2]", ["stiffness_n_per_m2"]),
            ("mean displacement [mm]", ["mean_stretch_mm", "true_mean_stretch_mm"]),
        ]
        figure = Figure(figsize=(8, 8), layout="constrained")
        for axes, (label, names) in zip(figure.subplots(len(charts), sharex=True), charts):
            for name in names:
                axes.plot(self.series["t_s"], self.series[name], label=name)
            axes.set_ylabel(label)
            axes.legend(fontsize="small")
        axes.set_xlabel("time [s]")
        figure.suptitle(str(self.ended))
        return figure

    def __repr__(self):
        return f"Run({self.ended!r}, steps={len(self.series['t_s'])})"

    def _repr_html_(self):
        rows = "".join(
            f"<tr><th>{html.escape(key)}</th><td>{html.escape(str(value))}</td></tr>"
            for key, value in (self.summary or {"ended": "the log breaks off"}).items()
        )
        return f"<table>{rows}</table>"


def run(
    config=None,
    *,
    law=None,
    plant=None,
    sensor=None,
    seed=None,
    set=None,
    out=None,
    progress=None,
):
    """Carries out one simulated insertion.

    Parameters
    ----------
    config : dict or path, optional
        See `config`.
    law : str or object, optional
        A law's name, or an object with ``decide(view)`` that answers a base twist (6,): velocity of
        the base's origin [m/s], then angular velocity [rad/s], in World. ``view`` is a `LawView`.
        The twist is held to the limits like any law's. ``reset()`` is called, where there is one,
        when a target is set; the attribute ``name``, or the class's, names it in the summary.
    plant : str or object, optional
        ``"phantom"``, ``"springs"``, ``"continuum"``, or an object with
        ``advance(world_from_base, time)`` (a pose (4, 4) and seconds) and ``shape()``: the centre
        line (n, 3) in World [m], from the base to the tip. Robot flaws and sensors stay those of the phantom.
    sensor : {"images", "shape"}, optional
        What closes the loop.
    seed : int, optional
        Seed of everything random.
    set : dict, optional
        Values by dotted keys.
    out : path, optional
        Folder for log, series, summary, configuration and plot; None writes nothing.
    progress : bool or callable, optional
        True for tqdm's meter (millimetres of depth), or a function like ``tqdm.tqdm``.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        What was given cannot be used.
    Error
        The insertion could not be carried out. One that ends early is a verdict instead.
    KeyboardInterrupt
        After Ctrl-C; the arm is stopped first.
    Exception
        What an own law or plant raises; the arm is stopped first.
    """
    if set is not None and not isinstance(set, Mapping):
        raise InputError(f"argument `set`: expected a dict of dotted keys, found {set!r}")
    with shown(progress, None, "mm") as meter:
        return Run(*_core.run(config, law, plant, sensor, seed, set, out, meter))


def read_log(path):
    """The run of a log (MCAP) or of its folder.

    Returns
    -------
    Run
    """
    summary, series, config, complete = _core.read_log(path)
    return Run(json.loads(summary) if summary else None, series, config, complete, log=path)


def report(of, path):
    """Writes an HTML page of a log, its folder, a campaign's folder or the JSON of ``reproduce``.

    Parameters
    ----------
    of, path : path
        What to report on, and the page. Only an older page is written over.
    """
    _core.report(of, path)


def shape(case):
    """Equilibrium of the needle model for a given state, as ``needle-steer shape`` prints it.

    Parameters
    ----------
    case : dict or path
        Needle, base pose, tip load and springs, as in the JSON of the command.

    Returns
    -------
    dict
        ``tip_m``, ``tip_direction``, ``spring_points_m``, ``shape`` (rows of arc length and place),
        ``j_tip_base`` (base twist to tip twist), ``iterations``, ``residual``; World, metres.
    """
    if isinstance(case, Mapping):
        return _core.shape(json.dumps(case))
    with open(os.fspath(case), encoding="utf-8") as file:
        text = file.read()
    try:
        return _core.shape(text)
    except InputError as error:
        raise InputError(f"{os.fspath(case)}: {error}") from None
