//! A law in Python.

use hal::Twist;
use hal::telemetry::SteeringMode;
use hybrid_control::{Decision, Estimator, Law, Limits, RollTravel, Rollout, Springs, Tip, View};
use nalgebra::{Isometry3, Vector3};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays::{matrix, numbers, places, pose, vector};
use crate::convert::document;
use crate::errors::input;
use crate::work::Failure;

/// What a law sees at one step. Everything is in World and in SI units unless a name says otherwise;
/// poses are homogeneous matrices (4, 4), twists are the velocity of a frame's origin, then the
/// angular velocity.
#[pyclass(frozen, module = "needle_steer")]
pub(crate) struct LawView {
    /// Time on the run's clock [s].
    #[pyo3(get)]
    time: f64,
    /// Time for which the decision will act [s].
    #[pyo3(get)]
    dt: f64,
    /// Length of needle in the tissue [m].
    #[pyo3(get)]
    depth: f64,
    /// Nominal speed of insertion [m/s].
    #[pyo3(get)]
    insertion_speed: f64,
    /// Tissue stiffness per length, estimated [N/m2].
    #[pyo3(get)]
    stiffness: f64,
    /// Natural curvature of the path, estimated [1/m].
    #[pyo3(get)]
    natural_curvature: f64,
    /// Error of the bevel's azimuth, estimated [rad].
    #[pyo3(get)]
    bevel_azimuth: f64,
    /// How far the tip's slope follows a pivot of the base: 1 at the surface, 0 deep inside.
    #[pyo3(get)]
    pivot_authority: f64,
    tip: Tip,
    target: Vector3<f64>,
    target_velocity: Vector3<f64>,
    entry: Vector3<f64>,
    inward: Vector3<f64>,
    base: Isometry3<f64>,
    springs: Option<Springs>,
    shape: Vec<Vector3<f64>>,
    /// As it was at the step: predictions are made when a law asks for them.
    estimator: Estimator,
    roll_travel: RollTravel,
    limits: Limits,
}

impl LawView {
    fn new(view: &View<'_>) -> Self {
        let estimator: &Estimator = view.estimator;
        Self {
            time: view.time.as_secs(),
            dt: view.dt,
            depth: view.depth,
            insertion_speed: view.insertion_speed,
            stiffness: estimator.stiffness().0,
            natural_curvature: estimator.natural_curvature(),
            bevel_azimuth: estimator.bevel_azimuth(),
            pivot_authority: estimator.pivot_authority(),
            tip: view.tip,
            target: view.target.position.coords,
            target_velocity: view.target.velocity,
            entry: view.entry.point.coords,
            inward: view.entry.inward.into_inner(),
            base: view.world_from_base,
            springs: view.springs,
            shape: view.shape.to_vec(),
            estimator: estimator.clone(),
            roll_travel: view.roll_travel,
            limits: view.limits.clone(),
        }
    }

    fn axis(&self) -> Vector3<f64> {
        self.base.rotation * Vector3::z()
    }
}

fn twist<'py>(
    py: Python<'py>,
    linear: &Vector3<f64>,
    angular: &Vector3<f64>,
) -> Bound<'py, PyArray1<f64>> {
    let [x, y, z]: [f64; 3] = (*linear).into();
    let [rx, ry, rz]: [f64; 3] = (*angular).into();
    vector(py, &[x, y, z, rx, ry, rz])
}

#[pymethods]
impl LawView {
    /// Pose of the tip (4, 4): origin O, z along the axis, bevel direction -y.
    #[getter]
    fn tip<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        pose(py, &self.tip.world_from_tip)
    }

    /// The tip's axis (3,).
    #[getter]
    fn tip_axis<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.tip.axis().as_slice())
    }

    /// Standard deviation of the tip's position across the axis, per axis [m].
    #[getter]
    fn tip_position_sigma(&self) -> f64 {
        self.tip.position_sigma
    }

    /// Standard deviation of the tip's direction, per axis [rad].
    #[getter]
    fn tip_direction_sigma(&self) -> f64 {
        self.tip.direction_sigma
    }

    /// Time since the last measurement [s]; infinite before the first.
    #[getter]
    fn tip_age(&self) -> f64 {
        self.tip.age
    }

    /// The target (3,) [m].
    #[getter]
    fn target<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.target.as_slice())
    }

    /// Its velocity (3,) [m/s].
    #[getter]
    fn target_velocity<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.target_velocity.as_slice())
    }

    /// The target in the tip's frame (3,) [m].
    #[getter]
    fn target_in_tip<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.tip.locate(&self.target.into()).as_slice())
    }

    /// A vector of World (3,) in the tip's axes.
    fn to_tip<'py>(
        &self,
        py: Python<'py>,
        vector: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let given = Vector3::from(numbers::<3>(vector, "vector")?);
        let turned = self.tip.world_from_tip.inverse_transform_vector(&given);
        Ok(crate::arrays::vector(py, turned.as_slice()))
    }

    /// The entry point on the surface (3,) [m].
    #[getter]
    fn entry<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.entry.as_slice())
    }

    /// Normal of the surface, into the tissue (3,).
    #[getter]
    fn inward<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.inward.as_slice())
    }

    /// Pose of the needle's base (4, 4), z along the needle.
    #[getter]
    fn base<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        pose(py, &self.base)
    }

    /// Base twist to tip twist (6, 6), by the springs model; None while it has no equilibrium.
    #[getter]
    fn jacobian<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.springs
            .map(|s| matrix(py, s.j_tip_base.transpose().as_slice().to_vec(), 6))
            .transpose()
    }

    /// Mean tissue displacement by the springs model [m]; None while it has no equilibrium.
    #[getter]
    fn mean_stretch(&self) -> Option<f64> {
        self.springs.map(|s| s.mean_stretch)
    }

    /// Its derivative by the base twist (6,) [m per unit twist]; None while there is no equilibrium.
    #[getter]
    fn mean_stretch_jacobian<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.springs
            .map(|s| vector(py, s.j_mean_stretch.transpose().as_slice()))
    }

    /// Tissue displacement at the entry by the springs model [m]; None while it has no equilibrium.
    #[getter]
    fn entry_stretch(&self) -> Option<f64> {
        self.springs.map(|s| s.entry_stretch)
    }

    /// The needle by the springs model (n, 3), base to tip [m]; empty while it has no equilibrium.
    #[getter]
    fn shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        places(py, self.shape.iter())
    }

    /// Target minus where the tip is predicted to cross its depth if the base keeps its direction
    /// (3,) [m].
    #[getter]
    fn predicted_miss<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let mut rollout = Rollout::new();
        self.estimator.rollout(&self.target.into(), &mut rollout);
        vector(py, self.estimator.lateral(&rollout.miss).as_slice())
    }

    /// Travel left for spinning in the negative and in the positive sense (2,), both positive [rad].
    #[getter]
    fn roll_travel<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, &[self.roll_travel.negative, self.roll_travel.positive])
    }

    /// The table `[limits]` of the configuration: units in the keys.
    #[getter]
    fn limits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        document(py, &self.limits)
    }

    /// Base twist (6,) of insertion at `speed` [m/s] along the needle and spin about it [rad/s].
    fn screw<'py>(&self, py: Python<'py>, speed: f64, spin: f64) -> Bound<'py, PyArray1<f64>> {
        let axis = self.axis();
        twist(py, &(axis * speed), &(axis * spin))
    }

    /// Base twist (6,) of a rotation about the entry point at `omega` (3,) [rad/s].
    fn pivot<'py>(
        &self,
        py: Python<'py>,
        omega: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let omega = Vector3::from(numbers::<3>(omega, "omega")?);
        let arm = self.base.translation.vector - self.entry;
        Ok(twist(py, &omega.cross(&arm), &omega))
    }

    fn __repr__(&self) -> String {
        format!("LawView(time={:.3}, depth={:.4})", self.time, self.depth)
    }
}

/// A law in Python, as the product takes it.
pub(crate) struct OwnLaw {
    object: Py<PyAny>,
    name: String,
    resets: bool,
    failure: Failure,
}

impl OwnLaw {
    pub(crate) fn new(object: &Bound<'_, PyAny>, failure: Failure) -> PyResult<Self> {
        let decides = object.getattr("decide").is_ok_and(|d| d.is_callable());
        if !decides {
            return Err(input(format!(
                "argument `law`: expected a law's name or an object with decide(view), found {}",
                crate::arrays::shown(object)
            )));
        }
        let given = object.getattr("name").ok();
        let name = given
            .and_then(|name| name.extract::<String>().ok())
            .map_or_else(|| Ok(object.get_type().name()?.to_string()), PyResult::Ok)?;
        Ok(Self {
            object: object.clone().unbind(),
            name,
            resets: object.hasattr("reset")?,
            failure,
        })
    }

    fn ask(&mut self, view: &View<'_>) -> PyResult<Twist> {
        let seen = LawView::new(view);
        Python::attach(|py| {
            let answer = self.object.bind(py).call_method1("decide", (seen,))?;
            let what = format!("law {}: decide's base twist [m/s, rad/s]", self.name);
            let [x, y, z, rx, ry, rz] = numbers::<6>(&answer, &what)?;
            Ok(Twist {
                linear: Vector3::new(x, y, z),
                angular: Vector3::new(rx, ry, rz),
            })
        })
    }
}

impl Law for OwnLaw {
    fn name(&self) -> &str {
        &self.name
    }

    fn decide(&mut self, view: &View<'_>) -> Decision {
        let mut decision = Decision::hold();
        match self.ask(view) {
            Ok(twist) => {
                decision.twist = twist;
                decision.report.mode = SteeringMode::Manipulation;
            }
            // The arm is stopped; the exception comes out of the call.
            Err(raised) => self.failure.note(raised),
        }
        decision
    }

    fn reset(&mut self) {
        if self.resets {
            let done = Python::attach(|py| self.object.bind(py).call_method0("reset").map(drop));
            if let Err(raised) = done {
                self.failure.note(raised);
            }
        }
    }
}
