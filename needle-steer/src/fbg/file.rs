//! Calibrations as packages for shape-sensing needles write them: JSON with matrices for each active area.
//!
//! The keys are those of the files that came with the needles of Lezcano et al. (Johns Hopkins University,
//! 2020 to 2023): lengths in mm, matrices from shifts in nm less what the channels have in common to curvature in
//! 1/m, two rows, a column for each channel (each but the central one where there is one). Keys that are not
//! read here are left alone.

use std::path::Path;

use nalgebra::Matrix2xX;
use serde_json::{Map, Value};

use super::{Area, Calibration, FibreError};
use crate::config::LocationsFrom;

const SERIAL: &str = "serial number";
const LENGTH: &str = "length";
const CHANNELS: &str = "# channels";
const AREAS: &str = "# active areas";
const CENTRAL: &str = "Central Core CH";
const LOCATIONS: &str = "Sensor Locations";
const MATRICES: &str = "Calibration Matrices";
const WEIGHTS: &str = "weights";

/// Most channels that are read.
const MOST: usize = 64;
/// How far a matrix's key may be from its area's location \[mm\].
const SAME_MM: f64 = 1e-3;

type Problem = (String, String);

/// Reads a calibration.
///
/// # Errors
/// See [`FibreError`].
pub(super) fn read(file: &Path, from: LocationsFrom) -> Result<Calibration, FibreError> {
    let text = std::fs::read_to_string(file).map_err(|source| FibreError::Read {
        file: file.to_owned(),
        source,
    })?;
    let document: Map<String, Value> =
        serde_json::from_str(&text).map_err(|error| FibreError::Text {
            file: file.to_owned(),
            problem: error.to_string(),
        })?;
    parse(&document, from).map_err(|(key, problem)| FibreError::Value {
        file: file.to_owned(),
        key,
        problem,
    })
}

fn parse(document: &Map<String, Value>, from: LocationsFrom) -> Result<Calibration, Problem> {
    let channels = count(document, CHANNELS)?;
    let mut central = None;
    if document.contains_key(CENTRAL) {
        let told = count(document, CENTRAL)?;
        if told > channels {
            let problem = format!("expected a channel from 1 to {channels}, found {told}");
            return Err((CENTRAL.to_owned(), problem));
        }
        central = Some(told - 1);
    }
    let least = if central.is_some() { 4 } else { 3 };
    if channels < least {
        let problem = format!(
            "expected at least {least} (two directions of bending, and what all channels have in common), found \
             {channels}"
        );
        return Err((CHANNELS.to_owned(), problem));
    }
    let length = number(document.get(LENGTH), LENGTH)?;
    if length <= 0.0 {
        let problem = format!("expected the needle's length in mm, found {length}");
        return Err((LENGTH.to_owned(), problem));
    }
    let told = count(document, AREAS)?;
    let locations = table(document, LOCATIONS)?;
    if locations.len() != told {
        let problem = format!(
            "expected {told} areas (key `{AREAS}`), found {}",
            locations.len()
        );
        return Err((LOCATIONS.to_owned(), problem));
    }
    let matrices = table(document, MATRICES).map_err(|(key, problem)| {
        let problem =
            format!("{problem}; a file without it is of a needle that was not calibrated yet");
        (key, problem)
    })?;
    let weights = document
        .contains_key(WEIGHTS)
        .then(|| table(document, WEIGHTS));
    let weights = weights.transpose()?;
    let outer = channels - usize::from(central.is_some());
    let mut areas = Vec::with_capacity(told);
    for (name, location) in locations {
        let key = format!("{LOCATIONS}.{name}");
        let location = number(Some(location), &key)?;
        if !(0.0..=length).contains(&location) {
            let problem = format!("expected a place from 0 to {length} mm, found {location}");
            return Err((key, problem));
        }
        let (found, matrix) = at(matrices, location).ok_or_else(|| {
            let problem = format!("no matrix for the area at {location} mm (`{key}`)");
            (MATRICES.to_owned(), problem)
        })?;
        let weight = match weights {
            None => 1.0,
            Some(weights) => {
                let (name, weight) = at(weights, location).ok_or_else(|| {
                    let problem = format!(
                        "none for the area at {location} mm; without `{WEIGHTS}` all count alike"
                    );
                    (WEIGHTS.to_owned(), problem)
                })?;
                let key = format!("{WEIGHTS}.{name}");
                let weight = number(Some(weight), &key)?;
                if weight < 0.0 {
                    return Err((key, format!("expected a number from 0, found {weight}")));
                }
                weight
            }
        };
        areas.push(Area {
            from_tip: 1e-3
                * match from {
                    LocationsFrom::Base => length - location,
                    LocationsFrom::Tip => location,
                },
            matrix: matrix_of(matrix, outer, &format!("{MATRICES}.{found}"))?,
            weight,
        });
    }
    let calibration = Calibration {
        serial: (document.get(SERIAL).and_then(Value::as_str))
            .unwrap_or_default()
            .to_owned(),
        channels,
        central,
        areas,
    };
    checked(calibration)
}

/// Areas in order, none twice, none without weight; each tells both directions.
fn checked(mut calibration: Calibration) -> Result<Calibration, Problem> {
    let areas = &mut calibration.areas;
    areas.sort_by(|a, b| b.from_tip.total_cmp(&a.from_tip));
    if let Some(pair) = areas
        .windows(2)
        .find(|pair| pair[0].from_tip - pair[1].from_tip < SAME_MM * 1e-3)
    {
        let problem = format!("two areas at {:.1} mm from the tip", pair[0].from_tip * 1e3);
        return Err((LOCATIONS.to_owned(), problem));
    }
    let mean = areas.iter().map(|area| area.weight).sum::<f64>() / areas.len() as f64;
    for area in areas.iter_mut() {
        area.weight /= mean;
        // Not a number where all are zero.
        if area.weight.is_nan() || area.weight <= 0.0 {
            let problem = format!(
                "the area {:.1} mm from the tip counts for nothing: expected a weight above 0; give it a small one",
                area.from_tip * 1e3
            );
            return Err((WEIGHTS.to_owned(), problem));
        }
    }
    if let Some(area) = calibration
        .areas
        .iter()
        .find(|area| !calibration.spans(area))
    {
        let problem = format!(
            "the matrix of the area {:.1} mm from the tip tells one direction of bending only, once what all channels \
             have in common is taken off: calibrate the area anew, bent in two directions",
            area.from_tip * 1e3
        );
        return Err((MATRICES.to_owned(), problem));
    }
    Ok(calibration)
}

/// A whole number from 1.
fn count(document: &Map<String, Value>, key: &str) -> Result<usize, Problem> {
    let value = document.get(key).and_then(Value::as_u64);
    let count = value.and_then(|value| usize::try_from(value).ok());
    count
        .filter(|count| (1..=MOST).contains(count))
        .ok_or_else(|| {
            let problem = format!(
                "expected a whole number from 1 to {MOST}, found {}",
                shown(document.get(key))
            );
            (key.to_owned(), problem)
        })
}

fn number(value: Option<&Value>, key: &str) -> Result<f64, Problem> {
    let number = value
        .and_then(Value::as_f64)
        .filter(|number| number.is_finite());
    number.ok_or_else(|| {
        (
            key.to_owned(),
            format!("expected a number, found {}", shown(value)),
        )
    })
}

fn table<'a>(
    document: &'a Map<String, Value>,
    key: &str,
) -> Result<&'a Map<String, Value>, Problem> {
    let value = document.get(key);
    let table = value
        .and_then(Value::as_object)
        .filter(|table| !table.is_empty());
    table.ok_or_else(|| {
        let problem = format!(
            "expected a table with an entry for each area, found {}",
            shown(value)
        );
        (key.to_owned(), problem)
    })
}

/// The entry whose key is a place \[mm\].
fn at(table: &Map<String, Value>, place: f64) -> Option<(&String, &Value)> {
    table.iter().find(|(key, _)| {
        key.parse::<f64>()
            .is_ok_and(|key| (key - place).abs() < SAME_MM)
    })
}

fn matrix_of(value: &Value, columns: usize, key: &str) -> Result<Matrix2xX<f64>, Problem> {
    let wrong = |problem: String| Err((key.to_owned(), problem));
    let rows = value.as_array().map(Vec::as_slice);
    let Some([first, second]) = rows else {
        return wrong(format!(
            "expected two rows, for the turns about x and y, found {}",
            shown(Some(value))
        ));
    };
    let mut matrix = Matrix2xX::zeros(columns);
    for (i, row) in [first, second].into_iter().enumerate() {
        let row = row.as_array().map(Vec::as_slice).unwrap_or_default();
        if row.len() != columns {
            return wrong(format!(
                "expected {columns} numbers in row {} (a channel each), found {}",
                i + 1,
                row.len()
            ));
        }
        for (k, value) in row.iter().enumerate() {
            matrix[(i, k)] = number(Some(value), &format!("{key}[{i}][{k}]"))?;
        }
    }
    Ok(matrix)
}

/// A value in an error, short.
fn shown(value: Option<&Value>) -> String {
    match value {
        None => "nothing".to_owned(),
        Some(Value::Array(rows)) => format!("a list of {}", rows.len()),
        Some(Value::Object(keys)) => format!("a table of {}", keys.len()),
        Some(value) => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn document() -> Value {
        json!({
            "serial number": "A-1",
            "length": 120.0,
            "diameter": 0.7,
            "# channels": 3,
            "# active areas": 2,
            "Sensor Locations": {"1": 40, "2": 110.0},
            "Calibration Matrices": {
                "40.0": [[0.0, 1.9, -1.9], [-2.2, 1.1, 1.1]],
                "110.0": [[0.1, 1.8, -1.9], [-2.0, 1.2, 1.0]],
            },
            "weights": {"40.0": 0.75, "110.0": 0.25},
        })
    }

    fn parsed(document: &Value) -> Result<Calibration, Problem> {
        parse(document.as_object().unwrap(), LocationsFrom::Base)
    }

    #[test]
    fn areas_come_from_the_base_to_the_tip_with_their_weights() {
        let calibration = parsed(&document()).unwrap();
        assert_eq!(calibration.serial, "A-1");
        let found: Vec<_> = calibration
            .areas
            .iter()
            .map(|a| (a.from_tip * 1e3, a.weight))
            .collect();
        assert!((found[0].0 - 80.0).abs() < 1e-9 && (found[1].0 - 10.0).abs() < 1e-9);
        assert!((found[0].1 - 1.5).abs() < 1e-12 && (found[1].1 - 0.5).abs() < 1e-12);
        let from_tip = parse(document().as_object().unwrap(), LocationsFrom::Tip).unwrap();
        assert!((from_tip.areas[0].from_tip - 0.11).abs() < 1e-12);
    }

    #[test]
    fn a_central_core_tells_what_all_have_in_common() {
        let mut document = document();
        document["# channels"] = json!(4);
        document["Central Core CH"] = json!(4);
        let calibration = parsed(&document).unwrap();
        let shifts = [0.5, 0.6, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0];
        let turn = calibration.curvature(0, &shifts).unwrap();
        assert!(
            (turn.x - 0.19).abs() < 1e-12 && (turn.y - 0.11).abs() < 1e-12,
            "{turn}"
        );
    }

    #[test]
    fn what_is_wrong_is_named_by_its_key() {
        let cases: [(&[&str], Value, &str, &str); 10] = [
            (&["# channels"], json!(2), "# channels", "at least 3"),
            (&["# channels"], json!("3"), "# channels", "whole number"),
            (
                &["# active areas"],
                json!(3),
                "Sensor Locations",
                "expected 3 areas",
            ),
            (&["length"], json!(null), "length", "found null"),
            (
                &["Sensor Locations", "2"],
                json!(130),
                "Sensor Locations.2",
                "from 0 to 120",
            ),
            (
                &["Sensor Locations", "2"],
                json!(41),
                "Calibration Matrices",
                "no matrix for the area at 41",
            ),
            (
                &["Calibration Matrices", "40.0"],
                json!([[1, 2, 3]]),
                "Calibration Matrices.40.0",
                "two rows",
            ),
            (
                &["Calibration Matrices", "40.0"],
                json!([[1, 2, 3], [1, 2]]),
                "Calibration Matrices.40.0",
                "row 2",
            ),
            (
                &["Calibration Matrices", "40.0"],
                json!([[1, 2, 3], [2, 3, 4]]),
                "Calibration Matrices",
                "one direction",
            ),
            (&["weights", "40.0"], json!(0), "weights", "above 0"),
        ];
        for (path, value, key, words) in cases {
            let mut document = document();
            let mut place = &mut document;
            for part in path {
                place = &mut place[*part];
            }
            *place = value;
            let (found, problem) = parsed(&document).unwrap_err();
            assert_eq!(found, key, "{problem}");
            assert!(problem.contains(words), "{problem}");
        }
        let mut bare = document();
        bare.as_object_mut().unwrap().remove("Calibration Matrices");
        assert!(parsed(&bare).unwrap_err().1.contains("not calibrated yet"));
    }
}
