"""Campaigns: many runs, on any engine."""

import os
from concurrent.futures import FIRST_COMPLETED, wait

from . import _core
from ._errors import Error, InputError
from ._progress import shown

# How often a run is given to an engine that loses its workers, before it is done here.
ATTEMPTS = 3


class Campaign:
    """The results of a campaign.

    Attributes
    ----------
    table : str
        CSV, a line each run: byte for byte the ``results.csv`` of ``needle-steer campaign``.
    rows : list of dict
        The same as dicts.
    conclusions : dict
        Distributions and pairwise comparisons, as ``conclusions.json`` has them.
    """

    def __init__(self, table, rows, conclusions):
        self.table = table
        self.rows = rows
        self.conclusions = conclusions

    def save(self, path):
        """Writes the table as CSV; a file that is there is not written over."""
        with open(path, "x", encoding="utf-8", newline="") as file:
            file.write(self.table)

    def __repr__(self):
        return f"Campaign({len(self.rows)} runs)"


def campaign(plan, executor=None, *, jobs=None, progress=None):
    """Carries out a campaign: laws times phantoms times targets times seeds.

    Parameters
    ----------
    plan : dict or path
        A campaign's file, or its keys: ``laws``, ``phantoms``, ``seeds``, ``target``, ``config`` ...
    executor : optional
        None for threads of this process; a `concurrent.futures.Executor`; a ``dask.distributed``
        client; ``"ray"`` for a local Ray or the cluster that ``ray.init`` joined, or
        ``"ray://ADDRESS"``. Workers need this package. A run lost with its worker is done again.
    jobs : int, optional
        Threads where there is no executor; all cores by default. Results do not depend on it.
    progress : bool or callable, optional
        See `run`.

    Returns
    -------
    Campaign

    Raises
    ------
    InputError
        The plan cannot be used.
    """
    text, name, count = _core.campaign_plan(plan)
    numbers = list(range(count))
    with shown(progress, count, "run") as meter:
        step = (lambda: meter.update(1)) if meter is not None else None
        if executor is None:
            lines = _here(text, name, numbers, jobs, step)
        elif isinstance(executor, str):
            lines = _on_ray(executor, text, name, numbers, step)
        elif hasattr(executor, "submit"):
            lines = _on_futures(executor, text, name, numbers, jobs, step)
        else:
            raise InputError(
                "executor: expected None, an executor with submit(), a Dask client or \"ray\", "
                f"found {executor!r}"
            )
    return Campaign(*_core.campaign_conclude(text, name, lines))


def _here(text, name, numbers, jobs, step):
    return _core.campaign_lines(text, name, numbers, jobs or os.cpu_count() or 1, step)


def _one(text, name, number):
    """One run's line, on whatever machine this is."""
    return _core.campaign_lines(text, name, [number], 1, None)[0]


def _on_futures(executor, text, name, numbers, jobs, step):
    """Runs on an executor of `concurrent.futures` or a Dask client; runs that are lost are given
    again, and done here where the engine takes no more."""
    lines = {}
    dask = hasattr(executor, "scheduler")
    # A function without side effects would be computed once for equal arguments only; fine.
    left = numbers
    for _ in range(ATTEMPTS):
        pending, refused = {}, False
        for number in left:
            try:
                pending[executor.submit(_one, text, name, number)] = number
            except RuntimeError:
                # Broken or shut down.
                refused = True
                break
        try:
            for future in _as_completed(pending, dask):
                try:
                    lines[pending[future]] = future.result()
                except (Error, KeyboardInterrupt):
                    raise
                except Exception:
                    # The worker is gone, not the run at fault: a run that fails is a line.
                    continue
                if step is not None:
                    step()
        except BaseException:
            for future in pending:
                future.cancel()
            raise
        left = [number for number in numbers if number not in lines]
        if not left or refused:
            break
    if left:
        lines.update(zip(left, _here(text, name, left, jobs, step)))
    return [lines[number] for number in numbers]


def _as_completed(pending, dask):
    if dask:
        from dask.distributed import as_completed

        yield from as_completed(list(pending))
        return
    waiting = set(pending)
    while waiting:
        done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
        yield from done


def _on_ray(executor, text, name, numbers, step):
    """Runs on Ray, which gives a lost worker's runs to another by itself."""
    if executor != "ray" and not executor.startswith("ray://"):
        raise InputError(f"executor {executor!r}: expected \"ray\" or \"ray://ADDRESS\"")
    try:
        import ray
    except ImportError as missing:
        raise InputError("executor=\"ray\" needs Ray: pip install 'needle_steer[ray]'") from missing
    if not ray.is_initialized():
        ray.init(address=None if executor == "ray" else executor)
    remote = ray.remote(max_retries=ATTEMPTS)(_one)
    pending = {remote.remote(text, name, number): number for number in numbers}
    lines, waiting = {}, list(pending)
    try:
        while waiting:
            done, waiting = ray.wait(waiting)
            for reference in done:
                lines[pending[reference]] = ray.get(reference)
                if step is not None:
                    step()
    except BaseException:
        for reference in waiting:
            ray.cancel(reference, force=True)
        raise
    return [lines[number] for number in numbers]
