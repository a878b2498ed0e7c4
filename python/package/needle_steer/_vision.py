"""Calibration and tracking."""

import os

from . import _core


class Tracker:
    """Finds a needle in pairs of images.

    Parameters
    ----------
    calibration : path, or two paths
        The stereo calibration; two where it comes in two files.
    unit_mm : float, optional
        Unit of the calibration's lengths, where it is not the metre: 1 for millimetres.
    diameter_mm, bevel_mm : float, optional
        Outer diameter (a hint) and length of the bevel; 0 for a flat tip.
    blur_px : float, optional
        Blur of the images; found in them without.
    bright : bool, optional
        Whether the needle is brighter than what is behind it; found in the images without.
    """

    def __init__(
        self, calibration, *, unit_mm=None, diameter_mm=0.7, bevel_mm=0.0, blur_px=None, bright=None
    ):
        single = isinstance(calibration, (str, os.PathLike))
        files = [calibration] if single else list(calibration)
        self._tracker = _core.PairTracker(files, unit_mm, diameter_mm, bevel_mm, blur_px, bright)

    def track(self, left, right, time):
        """The needle in one pair.

        Parameters
        ----------
        left, right : ndarray (height, width) of uint8
            Grey images.
        time : float
            When they were taken [s]; it must not run backwards.

        Returns
        -------
        dict
            As a line of ``needle-steer track``: ``status``, ``tip_m`` (in the left camera's frame),
            ``shape_m``, ``tip_covariance_m2``, ``left_tip_px``, ``right_tip_px``, ``tip_point_m``, and
            ``reason`` where the needle was not measured.
        """
        return self._tracker.track(left, right, time)

    def reset(self):
        """Forgets needle and background."""
        self._tracker.reset()


def calibrate_stereo(left, right, board, square_mm, *, lens="plumb_bob", out=None):
    """Stereo calibration from photographs of a board.

    Parameters
    ----------
    left, right : list of path
        Images of the two cameras, in the same order.
    board : str
        ``"9x6"`` (inner corners), ``"charuco:7x5:DICT_4X4_50"`` or ``"circles:4x11"``.
    square_mm : float
        Side of a square, of circles the distance of two rows.
    lens : {"plumb_bob", "radtan", "rational_polynomial", "equidistant"}, optional
    out : path, optional
        Folder for the report and the calibration files.

    Returns
    -------
    dict
        As ``needle-steer calibrate stereo --json`` prints it.
    """
    return _core.calibrate_stereo(list(left), list(right), board, square_mm, lens, out)
