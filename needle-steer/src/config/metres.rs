//! Places and offsets that look as if they were given in metres.

use super::{Config, TargetKind};

/// Places nearer to an origin along every axis are most likely metres \[mm\]: laboratories are a few
/// metres wide, and nobody puts an arm a few millimetres beside an origin.
const NEAR: f64 = 5.0;
/// Offsets below it are none that a needle could be steered to \[mm\].
const LEAST_OFFSET: f64 = 0.1;
/// Farther from the entry no needle comes \[mm\].
const FARTHEST_FROM_ENTRY: f64 = 1000.0;

impl Config {
    /// What may be a length in another unit than the key's, a sentence each with what to write. A value
    /// that is certainly wrong is refused by [`Config::validate`] instead.
    pub fn doubtful_lengths(&self) -> Vec<String> {
        let mut found = Vec::new();
        let places = [
            ("tissue.entry_mm", self.tissue.entry_mm),
            ("arm.base_mm", self.arm.base_mm),
            ("tracker.position_mm", self.tracker.position_mm),
            (
                "supervisor.workspace_max_mm",
                self.supervisor.workspace_max_mm,
            ),
        ];
        for (key, place) in places {
            if is_near(&place) {
                found.push(in_metres(key, &place));
            }
        }
        let target = &self.target;
        match target.kind {
            TargetKind::Stereo | TargetKind::World if is_near(&target.position_mm) => {
                found.push(in_metres("target.position_mm", &target.position_mm));
            }
            TargetKind::World => {
                let away = (target.point() - self.entry()).norm() * 1e3;
                if away > FARTHEST_FROM_ENTRY {
                    found.push(format!(
                        "target.position_mm is {away:.0} mm from tissue.entry_mm: both are millimetres in World"
                    ));
                }
            }
            TargetKind::Shifted | TargetKind::Marker
                if target.offset_mm > 0.0 && target.offset_mm < LEAST_OFFSET =>
            {
                found.push(format!(
                    "target.offset_mm = {} is less than any needle is steered aside: if it is in metres, write {}",
                    target.offset_mm,
                    millimetres(target.offset_mm)
                ));
            }
            _ => {}
        }
        found
    }
}

/// Not the origin, and no laboratory's distance from it.
fn is_near(place: &[f64; 3]) -> bool {
    let farthest = place.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    farthest > 0.0 && farthest < NEAR
}

fn in_metres(key: &str, place: &[f64; 3]) -> String {
    format!(
        "{key} = {place:?} is within {NEAR} mm of the origin: if these are metres, write {:?}",
        place.map(millimetres)
    )
}

/// Metres in millimetres, without the digits that are rounding.
fn millimetres(metres: f64) -> f64 {
    (metres * 1e6).round() / 1e3
}

#[cfg(test)]
mod tests {
    use crate::config;

    fn doubts(overrides: &[&str]) -> Vec<String> {
        let overrides: Vec<String> = overrides.iter().map(|&o| o.to_owned()).collect();
        config::load(None, &overrides).unwrap().doubtful_lengths()
    }

    #[test]
    fn places_in_metres_are_told_with_what_to_write() {
        assert!(doubts(&[]).is_empty());
        for (given, told) in [
            (
                &["tissue.entry_mm=[0.4,0.0,0.25]"][..],
                "[400.0, 0.0, 250.0]",
            ),
            (
                &["arm.base_mm=[0.4008,-0.0099,0.4788]"],
                "[400.8, -9.9, 478.8]",
            ),
            (&["target.offset_mm=0.01"], "write 10"),
            (
                &["target.kind=stereo", "target.position_mm=[0.01,0.0,0.5]"],
                "[10.0, 0.0, 500.0]",
            ),
            (
                &["target.kind=world", "target.position_mm=[400.0,0.0,1800.0]"],
                "1550 mm from tissue.entry_mm",
            ),
        ] {
            let found = doubts(given);
            assert!(
                found.len() == 1 && found[0].contains(told),
                "{given:?}: {found:?}"
            );
        }
        // An origin is a place, and so is one in a laboratory.
        for given in [
            &["tissue.entry_mm=[0,0,0]", "arm.base_mm=[0,0,0]"][..],
            &["arm.base_mm=[0.0,12.0,0.0]"],
            &["target.offset_mm=0.0"],
        ] {
            assert!(doubts(given).is_empty(), "{given:?}");
        }
    }
}
