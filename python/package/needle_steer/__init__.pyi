from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

VERSION: str

_Path = str | PathLike[str]
_Config = Mapping[str, Any] | _Path | None
_Set = Mapping[str, Any] | None
_Array = NDArray[np.float64]
_Progress = bool | Callable[..., Any] | None

class _Law(Protocol):
    def decide(self, view: LawView) -> ArrayLike: ...

class _Plant(Protocol):
    def advance(self, world_from_base: _Array, time: float) -> Any: ...
    def shape(self) -> ArrayLike: ...

class Error(Exception): ...
class InputError(Error, ValueError): ...
class InternalError(Error, RuntimeError): ...

class Run:
    summary: dict[str, Any] | None
    series: dict[str, _Array | list[str]]
    config: dict[str, Any]
    complete: bool
    @property
    def ended(self) -> str | None: ...
    def report(self, path: _Path) -> None: ...
    def plot(self) -> Any: ...

class Campaign:
    table: str
    rows: list[dict[str, Any]]
    conclusions: dict[str, Any]
    def save(self, path: _Path) -> None: ...

class LawView:
    time: float
    dt: float
    depth: float
    insertion_speed: float
    stiffness: float
    natural_curvature: float
    bevel_azimuth: float
    pivot_authority: float
    tip: _Array
    tip_axis: _Array
    tip_position_sigma: float
    tip_direction_sigma: float
    tip_age: float
    target: _Array
    target_velocity: _Array
    target_in_tip: _Array
    entry: _Array
    inward: _Array
    base: _Array
    jacobian: _Array | None
    mean_stretch: float | None
    mean_stretch_jacobian: _Array | None
    entry_stretch: float | None
    shape: _Array
    predicted_miss: _Array
    roll_travel: _Array
    limits: dict[str, float]
    def to_tip(self, vector: ArrayLike) -> _Array: ...
    def screw(self, speed: float, spin: float) -> _Array: ...
    def pivot(self, omega: ArrayLike) -> _Array: ...

class NeedleModel:
    tip: _Array
    base: _Array
    jacobian: _Array
    mean_stretch_jacobian: _Array
    springs: tuple[_Array, _Array]
    depth: float
    mean_stretch: float
    base_wrench: _Array
    def __init__(self, config: _Config = None, *, set: _Set = None) -> None: ...
    def insert(self, world_from_base: ArrayLike, measured_tip: ArrayLike | None = None) -> None: ...
    def move_base(self, world_from_base: ArrayLike) -> None: ...
    def rescale(self, stiffness: float) -> None: ...
    def shape(self, count: int = 100) -> _Array: ...

class Phantom:
    base: _Array
    time: float
    def __init__(
        self, config: _Config = None, *, seed: int | None = None, set: _Set = None
    ) -> None: ...
    def advance(self, world_from_base: ArrayLike, time: float) -> None: ...
    def sense(self) -> dict[str, Any] | None: ...
    def truth(self) -> dict[str, Any]: ...

class Chain:
    names: list[str]
    limits: _Array
    exhaustive: bool
    def __init__(
        self,
        urdf: _Path,
        tip: str,
        *,
        base: str | None = None,
        hold: Mapping[str, float] | None = None,
        mechanism: bool = False,
    ) -> None: ...
    def __len__(self) -> int: ...
    def fk(self, joints: ArrayLike) -> _Array: ...
    def jacobian(self, joints: ArrayLike) -> _Array: ...
    def ik(self, pose: ArrayLike, *, all_turns: bool = False) -> _Array | list[_Array]: ...

class Tracker:
    def __init__(
        self,
        calibration: _Path | Sequence[_Path],
        *,
        unit_mm: float | None = None,
        diameter_mm: float = 0.7,
        bevel_mm: float = 0.0,
        blur_px: float | None = None,
        bright: bool | None = None,
    ) -> None: ...
    def track(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8], time: float
    ) -> dict[str, Any]: ...
    def reset(self) -> None: ...

def config(config: _Config = None, *, set: _Set = None) -> dict[str, Any]: ...
def run(
    config: _Config = None,
    *,
    law: str | _Law | None = None,
    plant: str | _Plant | None = None,
    sensor: Literal["images", "shape"] | None = None,
    seed: int | None = None,
    set: _Set = None,
    out: _Path | None = None,
    progress: _Progress = None,
) -> Run: ...
def read_log(path: _Path) -> Run: ...
def report(of: _Path, path: _Path) -> None: ...
def shape(case: Mapping[str, Any] | _Path) -> dict[str, Any]: ...
def campaign(
    plan: Mapping[str, Any] | _Path,
    executor: Any = None,
    *,
    jobs: int | None = None,
    progress: _Progress = None,
) -> Campaign: ...
def calibrate_stereo(
    left: Sequence[_Path],
    right: Sequence[_Path],
    board: str,
    square_mm: float,
    *,
    lens: Literal["plumb_bob", "radtan", "rational_polynomial", "equidistant"] = "plumb_bob",
    out: _Path | None = None,
) -> dict[str, Any]: ...
def estimate(
    files: _Path | Sequence[_Path], config: _Config = None, *, set: _Set = None
) -> tuple[dict[str, Any], dict[str, Any]]: ...
def validate(
    files: _Path | Sequence[_Path],
    config: _Config = None,
    *,
    set: _Set = None,
    html: _Path | None = None,
) -> dict[str, Any]: ...
def reproduce(
    experiments: Sequence[str] = ("e1", "e2", "e3", "e4"),
    *,
    law: str = "paper",
    runs: int = 20,
    seed: int = 1,
    phantom: str = "paper",
    sensor: str | None = None,
    brackets: bool = False,
    jobs: int | None = None,
    set: _Set = None,
    progress: _Progress = None,
) -> dict[str, Any]: ...
