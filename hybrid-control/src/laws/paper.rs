//! The paper's law: three tasks with redundancy, sliding mode and duty cycling; to the letter
//! or with the deviations that make it robust, each with its own switch.

use hal::Twist;
use hal::telemetry::{Limit, SteeringMode};
use nalgebra::{Matrix2, Matrix6, Rotation3, Unit, Vector3, Vector6};

use crate::laws::bevel_steering::BevelSteering;
use crate::priority::{Tasks, damped_stretch_reduction, prioritised_twist};
use crate::settings::PaperSettings;
use crate::tasks::{insertion_direction, sliding_mode, target_velocity};
use crate::view::{Decision, Law, Springs, View, blank_report};

pub(super) struct Paper {
    name: &'static str,
    settings: PaperSettings,
    steering: BevelSteering,
}

impl Paper {
    pub(super) fn new(name: &'static str, settings: &PaperSettings) -> Self {
        Self {
            name,
            settings: settings.clone(),
            steering: BevelSteering::new(settings),
        }
    }
}

impl Law for Paper {
    fn name(&self) -> &'static str {
        self.name
    }

    fn decide(&mut self, view: &View<'_>) -> Decision {
        let Some(springs) = &view.springs else {
            return Decision::hold();
        };
        let s = &self.settings;
        let mut report = blank_report();
        let desired = target_velocity(&self.steering.heading(view), view.insertion_speed);
        let command = self.steering.step(view, &desired, &mut report);
        report.base_authority = view.estimator.pivot_authority();
        report.shortfall = beside(view);
        let tasks = tasks(view, springs, &desired, command.spin, s);
        let mut v = if s.pivot_only {
            let omega = pivot_rate(view, springs, &desired, s);
            if omega.norm() >= view.limits.tilt_speed_deg_s.to_radians() * 0.999 {
                report.limits.push(Limit::TiltSpeed);
            }
            let speed = if command.duty_cycling {
                command.speed
            } else {
                insertion_part(&desired)
            };
            view.pivot(&omega).to_vector() + view.screw(speed, command.spin).to_vector()
        } else if command.duty_cycling {
            // The cycle replaces tasks one and two: insertion the way that moves the tip most.
            let tip_axes = in_tip_axes(springs);
            let length = s.length_scale_mm * 1e-3;
            let ins = in_metres(
                &insertion_direction(&column_scaled(&tip_axes, length)),
                length,
            );
            ins * command.speed + view.screw(0.0, command.spin).to_vector()
        } else {
            let length = s.length_scale_mm * 1e-3;
            let mut scaled = tasks.scaled(length);
            if s.damped_stretch || !s.stretch_task {
                scaled.stretch = 0.0;
            }
            in_metres(&prioritised_twist(&scaled), length)
        };
        if s.damped_stretch && s.stretch_task && report.mode != SteeringMode::DutyCycleSpin {
            v += bounded_stretch_reduction(&tasks, s);
        }
        Decision {
            twist: Twist::from_vector(&v),
            report,
        }
    }

    fn reset(&mut self) {
        self.steering.reset();
    }
}

/// Rotation of the base about the entry \[rad/s, World\] that gives the tip the lateral part of
/// `desired` (tip frame): damped (P1) and gated by the authority over the path (P2).
pub(super) fn pivot_rate(
    view: &View<'_>,
    springs: &Springs,
    desired: &Vector3<f64>,
    s: &PaperSettings,
) -> Vector3<f64> {
    let axis = Unit::new_normalize(view.base_axis());
    let e1 = view.world_from_base.rotation * Vector3::x();
    let e2 = axis.cross(&e1);
    let tip_from_world = springs.world_from_tip.rotation.inverse();
    let lateral = |e: &Vector3<f64>| {
        let tip = springs.j_tip_base * view.pivot(e).to_vector();
        (tip_from_world * tip.fixed_rows::<3>(0).into_owned()).xy()
    };
    let j = Matrix2::from_columns(&[lateral(&e1), lateral(&e2)]);
    let damping = Matrix2::identity() * s.pivot_damping_m.powi(2);
    let Some(inverse) = (j * j.transpose() + damping).try_inverse() else {
        return Vector3::zeros();
    };
    let gate = if s.authority_gate {
        let authority = view.estimator.pivot_authority();
        ((authority - s.gate_from) / (s.gate_to - s.gate_from).max(1e-6)).clamp(0.0, 1.0)
    } else {
        1.0
    };
    let rates = j.transpose() * inverse * desired.xy() * gate;
    (e1 * rates.x + e2 * rates.y).cap_magnitude(view.limits.tilt_speed_deg_s.to_radians())
}

/// Axial part of a desired tip velocity, but at least half of its size: a target beside the tip
/// is passed, not approached for ever.
pub(super) fn insertion_part(desired: &Vector3<f64>) -> f64 {
    desired.z.max(0.5 * desired.norm())
}

/// How far a target lies beside the tip that is no longer in front of it (more than 60 degrees
/// off the axis) \[m\]; NaN while it is in front.
pub(super) fn beside(view: &View<'_>) -> f64 {
    let seen = view.tip.locate(&view.target.position);
    let lateral = seen.xy().norm();
    if lateral > 3_f64.sqrt() * seen.z {
        lateral
    } else {
        f64::NAN
    }
}

/// The manipulation Jacobian with the tip twist in the axes of the tip.
fn in_tip_axes(springs: &Springs) -> Matrix6<f64> {
    let turn: Rotation3<f64> = springs
        .world_from_tip
        .rotation
        .inverse()
        .to_rotation_matrix();
    let mut j = springs.j_tip_base;
    for block in 0..2 {
        let rows = turn * j.fixed_rows::<3>(3 * block).into_owned();
        j.fixed_rows_mut::<3>(3 * block).copy_from(&rows);
    }
    j
}

fn tasks(
    view: &View<'_>,
    springs: &Springs,
    desired: &Vector3<f64>,
    spin: f64,
    s: &PaperSettings,
) -> Tasks {
    let j = in_tip_axes(springs);
    Tasks {
        j_v: j.fixed_rows::<3>(0).into_owned(),
        j_omega_z: j.fixed_rows::<1>(5).into_owned(),
        j_stretch: springs.j_mean_stretch,
        tip_velocity: *desired,
        spin: if s.robust_bevel {
            spin
        } else {
            spin_of_eq_15(view, desired, s)
        },
        stretch: springs.mean_stretch,
        stretch_gain: s.stretch_gain_per_s,
    }
}

fn spin_of_eq_15(view: &View<'_>, desired: &Vector3<f64>, s: &PaperSettings) -> f64 {
    let omega = s
        .omega_z_max_deg_s
        .min(view.limits.spin_speed_deg_s)
        .to_radians();
    sliding_mode(crate::tasks::bevel_angle(desired), omega)
}

fn column_scaled(j: &Matrix6<f64>, length: f64) -> Matrix6<f64> {
    let mut out = *j;
    out.fixed_columns_mut::<3>(3).unscale_mut(length);
    out
}

/// Back from a twist whose angular part was counted in metres.
fn in_metres(v: &Vector6<f64>, length: f64) -> Vector6<f64> {
    let mut out = *v;
    out.fixed_rows_mut::<3>(3).unscale_mut(length);
    out
}

/// P5: the third task, damped and never faster than half a millimetre a second.
fn bounded_stretch_reduction(tasks: &Tasks, s: &PaperSettings) -> Vector6<f64> {
    let length = s.length_scale_mm * 1e-3;
    // Damping at a derivative of 0.1 m/m: below it the mean stretch hardly depends on the base.
    let v = damped_stretch_reduction(&tasks.scaled(length), 1e-2);
    in_metres(&v.cap_magnitude(0.5e-3), length)
}
