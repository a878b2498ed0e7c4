//! Insertion: springs born at the tip as it cuts, the hole it leaves, the load on the bevel.
//!
//! The base is moved either with cutting ([`Insertion::insert`]) or without ([`Insertion::move_base`]).
//! A step is cut where an event falls inside it (a spring born each `pitch` of needle, the tip
//! passing a spring of its own hole), so the result does not depend on the steps' size.

use nalgebra::{Isometry3, Vector3};

use crate::bevel::Bevel;
use crate::equilibrium::{Convergence, Equilibrium};
use crate::equilibrium_error::EquilibriumError;
use crate::insertion_error::InsertionError;
use crate::needle::Needle;
use crate::spring::Spring;
use crate::tip_law::Law;
use crate::tissue::Tissue;

/// An event is placed within this of its exact place \[m\].
const EVENT_TOLERANCE: f64 = 1e-9;
/// Tolerance on the last Newton step \[m\]. Stiffness and load follow the needle with a lag of one
/// step, which shrinks at least tenfold each: the state is then within a nanometre.
const STEP_TOLERANCE: f64 = 1e-8;
/// Searches for one event before giving up.
const EVENT_TRIALS: usize = 60;
/// Events of one step before giving up: as many a sub-step, and some more. Far from any insertion,
/// a spring may be passed forwards and backwards without end.
const MOST_EVENTS: (f64, f64) = (4.0, 16.0);
/// Shortest pitch \[m\]: no tissue is known to so fine a scale, and the springs grow many.
const LEAST_PITCH: f64 = 1e-5;
/// Sub-steps of one step: 25 m at the usual pitch.
const MOST_PIECES: f64 = 1e4;

/// Where the tissue's rest position is when the tip cuts it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RestPoint {
    /// The measured tip centre O where one is given, the model's otherwise (section IV.B).
    #[default]
    Measured,
    /// The model's tip centre O: tissue cut by the needle is where the needle is.
    ModelCentre,
    /// The model's cutting edge: O displaced by the needle's radius in the bevel direction.
    CuttingEdge,
}

/// How an insertion is modelled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InsertionSettings {
    /// Length of needle between births of springs \[m\].
    ///
    /// The tip converges with the pitch, at first slowly (order 0.3 to 0.5 at 2.5 mm, 1e4 N/m2), for one
    /// reason: over the first 3 E I / (K_T L^3) of depth (0.28 mm there) the tissue takes the needle
    /// over from its holder, and a pitch above that does not resolve how the first rest points set the
    /// path. Below it the order is 1 and more. At 2.5 mm the
    /// deflection 80 mm deep is 17 to 19 % below the limit of fine pitches.
    pub pitch: f64,
    /// Rest point of a newborn spring.
    pub rest_point: RestPoint,
    /// Length of the cut path behind the tip whose chord gives the cut angle of eq. (3) \[m\].
    pub chord: f64,
    /// Factor on the tip load of eq. (3); 1 in the paper.
    pub load_scale: f64,
    /// Length after the entry over which the tip load grows to that of eq. (3) \[m\]; 0 in the paper.
    /// At the surface the needle has no support yet: the full load would push it aside by
    /// millimetres at once, by an amount that depends on the pitch.
    pub onset: f64,
}

impl Default for InsertionSettings {
    /// The paper's 2.5 mm; chord and onset of 10 mm (assumed: the paper defines neither).
    fn default() -> Self {
        Self {
            pitch: 2.5e-3,
            rest_point: RestPoint::Measured,
            chord: 10e-3,
            load_scale: 1.0,
            onset: 10e-3,
        }
    }
}

/// A needle being inserted.
#[derive(Debug, Clone)]
pub struct Insertion {
    needle: Equilibrium,
    law: Law,
    /// Springs of the hole beyond the tip, deepest first.
    hole: Vec<Spring>,
    /// Measured tip at the end of the last insertion step.
    measured: Option<Vector3<f64>>,
    /// Length of the needle at the beginning and at the end of the step \[m\]: they differ in a guide.
    lengths: (f64, f64),
    /// Springs and hole before the step, should it fail.
    backup: (Vec<Spring>, Vec<Spring>),
}

/// What bounds a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Event {
    Birth,
    Ahead,
    Behind,
}

impl Insertion {
    /// A straight needle before `tissue`, with its base at `world_from_base`.
    ///
    /// # Errors
    /// [`InsertionError`] for settings out of range or a tip already inside the tissue.
    pub fn new(
        needle: Needle,
        bevel: Bevel,
        tissue: Tissue,
        settings: InsertionSettings,
        world_from_base: &Isometry3<f64>,
    ) -> Result<Self, InsertionError> {
        for (name, value, least) in [
            ("pitch", settings.pitch, LEAST_PITCH),
            ("chord", settings.chord, f64::MIN_POSITIVE),
        ] {
            if !(value.is_finite() && value >= least) {
                return Err(InsertionError::Setting { name, value });
            }
        }
        for (name, value) in [
            ("load_scale", settings.load_scale),
            ("onset", settings.onset),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(InsertionError::Setting { name, value });
            }
        }
        if !finite(world_from_base) {
            return Err(InsertionError::BasePose);
        }
        let mut needle = Equilibrium::new(needle, *world_from_base);
        needle.set_tolerance(STEP_TOLERANCE);
        let depth_m = tissue.depth(&needle.tip_position());
        if depth_m > EVENT_TOLERANCE {
            return Err(InsertionError::StartsInside { depth_m });
        }
        let lengths = (needle.needle.length(), needle.needle.length());
        let law = Law {
            bevel,
            tissue,
            settings,
            entry_axis: needle.tip_axis(),
            offset: Vector3::zeros(),
            cut: 0.0,
            gaps: Vec::with_capacity(64),
            supported: Vec::with_capacity(64),
            beta: 0.0,
            response: 0.0,
        };
        Ok(Self {
            needle,
            law,
            hole: Vec::with_capacity(64),
            measured: None,
            lengths,
            backup: (Vec::with_capacity(64), Vec::with_capacity(64)),
        })
    }

    /// Moves the base without cutting: no spring is born, the tip may slide in its hole.
    ///
    /// # Errors
    /// [`InsertionError`].
    pub fn move_base(&mut self, world_from_base: &Isometry3<f64>) -> Result<(), InsertionError> {
        self.step(world_from_base, None, false)
    }

    /// Moves the base and lets the tip cut; `measured_tip` is O as measured at the end of the step.
    ///
    /// Rest points of springs born within the step lie between the last measured tip and this one,
    /// in the plane across the tip axis.
    ///
    /// # Errors
    /// [`InsertionError`].
    pub fn insert(
        &mut self,
        world_from_base: &Isometry3<f64>,
        measured_tip: Option<Vector3<f64>>,
    ) -> Result<(), InsertionError> {
        self.step(world_from_base, measured_tip, true)?;
        self.measured = measured_tip;
        Ok(())
    }

    /// As [`Insertion::insert`], for a needle that slides in a guide: `world_from_exit` is the pose of
    /// the guide's exit, `length` \[m\] of needle are beyond it at the end of the step.
    ///
    /// # Errors
    /// [`InsertionError`].
    pub fn insert_through(
        &mut self,
        world_from_exit: &Isometry3<f64>,
        length: f64,
        measured_tip: Option<Vector3<f64>>,
    ) -> Result<(), InsertionError> {
        self.needle.needle.with_length(length)?;
        self.lengths.1 = length;
        self.insert(world_from_exit, measured_tip)
    }

    fn step(
        &mut self,
        target: &Isometry3<f64>,
        measured: Option<Vector3<f64>>,
        cutting: bool,
    ) -> Result<(), InsertionError> {
        if !finite(target) {
            return Err(InsertionError::BasePose);
        }
        if measured.is_some_and(|m| !m.iter().all(|v| v.is_finite())) {
            return Err(InsertionError::MeasuredTip);
        }
        let from = *self.needle.world_from_base();
        self.lengths.0 = self.needle.needle.length();
        self.backup.0.clone_from(&self.needle.springs);
        self.backup.1.clone_from(&self.hole);
        let law = &self.law;
        let before = (law.entry_axis, law.offset, law.cut, law.beta);
        let result = self.walk(&from, target, measured, cutting);
        if result.is_err() {
            self.needle.springs.clone_from(&self.backup.0);
            self.hole.clone_from(&self.backup.1);
            self.needle.set_base(&from);
            self.set_length(self.lengths.0);
            self.lengths.1 = self.lengths.0;
            let law = &mut self.law;
            (law.entry_axis, law.offset, law.cut, law.beta) = before;
            self.needle
                .restart(|needle, round| law.update(needle, round))?;
        }
        result
    }

    fn walk(
        &mut self,
        from: &Isometry3<f64>,
        target: &Isometry3<f64>,
        measured: Option<Vector3<f64>>,
        cutting: bool,
    ) -> Result<(), InsertionError> {
        // Sub-steps short against the pitch, so that each holds few events.
        let slid = (self.lengths.1 - self.lengths.0).abs();
        let travel = (target.translation.vector - from.translation.vector).norm() + slid;
        let turn = from.rotation.angle_to(&target.rotation);
        let pieces = (travel / self.law.settings.pitch)
            .max(turn / 0.05)
            .ceil()
            .max(1.0);
        if !(pieces <= MOST_PIECES) {
            let (travel_m, turn_rad) = (travel, turn);
            return Err(InsertionError::Step { travel_m, turn_rad });
        }
        let mut events_left = MOST_EVENTS.0 * pieces + MOST_EVENTS.1;
        let mut done = 0.0;
        let mut piece = 1.0;
        while piece <= pieces {
            let end = piece / pieces;
            self.settle(from, target, end)?;
            let Some((event, gap_m)) = self.pending(cutting) else {
                done = end;
                piece += 1.0;
                continue;
            };
            events_left -= 1.0;
            if events_left < 0.0 {
                return Err(InsertionError::Event { gap_m });
            }
            done = self.locate(from, target, (done, end), event, cutting)?;
            match event {
                Event::Behind => {
                    self.hole.extend(self.needle.pop_spring());
                }
                Event::Ahead => {
                    if let Some(spring) = self.hole.pop() {
                        self.needle.push_spring(spring);
                    }
                }
                Event::Birth => self.bear(measured, done),
            }
            let law = &mut self.law;
            self.needle
                .converge(|needle, round| law.update(needle, round))?;
        }
        if cutting && !self.needle.springs.is_empty() {
            self.law.cut = self.law.cut.max(self.needle.inserted_length());
        }
        Ok(())
    }

    /// Equilibrium with the base `fraction` of the way.
    fn settle(
        &mut self,
        from: &Isometry3<f64>,
        target: &Isometry3<f64>,
        fraction: f64,
    ) -> Result<Convergence, EquilibriumError> {
        let base = if fraction >= 1.0 {
            *target
        } else {
            from.lerp_slerp(target, fraction)
        };
        if let Some(first) = self.needle.springs.first() {
            // The holder on the tissue: no free length is left to push.
            let ahead_m = (base * Vector3::z()).dot(&(first.rest - base.translation.vector));
            if !(ahead_m > 0.0) {
                return Err(EquilibriumError::BehindBase { index: 0, ahead_m });
            }
        }
        self.needle.set_base(&base);
        let (start, end) = self.lengths;
        if (end - start).abs() > 0.0 {
            self.set_length(start + (end - start) * fraction);
        }
        let law = &mut self.law;
        self.needle
            .converge(|needle, round| law.update(needle, round))
    }

    fn set_length(&mut self, length: f64) {
        if let Ok(needle) = self.needle.needle.with_length(length) {
            self.needle.set_length(needle);
        }
    }

    /// The event the present state has passed, and by how much \[m\].
    fn pending(&self, cutting: bool) -> Option<(Event, f64)> {
        [Event::Behind, Event::Ahead, Event::Birth]
            .into_iter()
            .filter_map(|event| Some((event, self.gap(event, cutting)?)))
            .find(|(_, gap)| *gap > EVENT_TOLERANCE)
    }

    /// How far the state is past an `event` \[m\]; `None` if it cannot happen.
    fn gap(&self, event: Event, cutting: bool) -> Option<f64> {
        let inside = !self.needle.springs.is_empty();
        match event {
            Event::Behind => inside.then_some(-self.needle.tip_length),
            Event::Ahead => {
                let next = self.hole.last()?;
                Some(
                    self.needle
                        .tip_axis()
                        .dot(&(self.needle.tip_position() - next.rest)),
                )
            }
            Event::Birth if !cutting || !self.hole.is_empty() => None,
            Event::Birth if inside => Some(self.needle.tip_length - self.law.settings.pitch),
            Event::Birth => Some(self.law.tissue.depth(&self.needle.tip_position())),
        }
    }

    /// Moves the base to where `event` happens within the span of fractions; returns the fraction.
    fn locate(
        &mut self,
        from: &Isometry3<f64>,
        target: &Isometry3<f64>,
        (start, end): (f64, f64),
        event: Event,
        cutting: bool,
    ) -> Result<f64, InsertionError> {
        let gap_of = |this: &Self| this.gap(event, cutting).unwrap_or(0.0);
        let mut high = (end, gap_of(self));
        self.settle(from, target, start)?;
        let mut low = (start, gap_of(self));
        if low.1 >= -EVENT_TOLERANCE {
            return Ok(start);
        }
        let mut gap_m = low.1;
        for trial in 0..EVENT_TRIALS {
            // Secant, with bisections now and then should the gap be far from linear.
            let secant = low.0 - low.1 * (high.0 - low.0) / (high.1 - low.1);
            let middle = if trial % 4 == 3 {
                f64::midpoint(low.0, high.0)
            } else {
                secant
            };
            self.settle(from, target, middle)?;
            gap_m = gap_of(self);
            if gap_m.abs() <= EVENT_TOLERANCE {
                return Ok(middle);
            }
            if gap_m > 0.0 {
                high = (middle, gap_m);
            } else {
                low = (middle, gap_m);
            }
        }
        Err(InsertionError::Event { gap_m })
    }

    /// A spring is born at the tip; `fraction` of the step is done.
    fn bear(&mut self, measured: Option<Vector3<f64>>, fraction: f64) {
        let (tip, axis) = (self.needle.tip_position(), self.needle.tip_axis());
        if let Some(end) = measured {
            let seen = self
                .measured
                .map_or(end, |start| start + (end - start) * fraction);
            let aside = seen - tip;
            self.law.offset = aside - axis * axis.dot(&aside);
        }
        if self.needle.springs.is_empty() {
            self.law.entry_axis = axis;
        }
        let rest = tip + self.law.offset(&self.needle);
        self.needle.push_spring(Spring {
            rest,
            stiffness: 0.0,
        });
    }

    /// The needle in equilibrium.
    pub const fn equilibrium(&self) -> &Equilibrium {
        &self.needle
    }

    /// The needle, for its derivatives (they refresh the tangent).
    pub const fn equilibrium_mut(&mut self) -> &mut Equilibrium {
        &mut self.needle
    }

    /// The tissue, with the stiffness as estimated so far.
    pub const fn tissue(&self) -> &Tissue {
        &self.law.tissue
    }

    /// The settings, with the tip-load scale as estimated so far.
    pub const fn settings(&self) -> &InsertionSettings {
        &self.law.settings
    }

    /// Springs of the hole that the tip has withdrawn from.
    pub const fn springs_ahead(&self) -> usize {
        self.hole.len()
    }

    /// Multiplies the tissue's stiffness and the tip-load scale, and settles anew. As eq. (3) is
    /// proportional to K_T, the tip load grows with the product of both.
    ///
    /// # Errors
    /// [`InsertionError`] for factors that are not finite and positive, or without equilibrium.
    pub fn rescale(&mut self, stiffness: f64, load: f64) -> Result<Convergence, InsertionError> {
        for (name, value) in [("stiffness factor", stiffness), ("load factor", load)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(InsertionError::Setting { name, value });
            }
        }
        self.law.tissue.scale_stiffness(stiffness);
        self.law.settings.load_scale *= load;
        let law = &mut self.law;
        Ok(self
            .needle
            .converge(|needle, round| law.update(needle, round))?)
    }
}

fn finite(pose: &Isometry3<f64>) -> bool {
    pose.translation
        .vector
        .iter()
        .chain(pose.rotation.coords.iter())
        .all(|v| v.is_finite())
}
