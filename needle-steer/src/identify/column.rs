//! Columns of a recording: their quantities, and their units by the header's suffix.

/// What a column's numbers measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Dimension {
    Time,
    Length,
    Angle,
    /// Components of quaternions and directions.
    Ratio,
}

impl Dimension {
    /// Suffixes and their factors to SI; the first is the one the documentation uses.
    const fn units(self) -> &'static [(&'static str, f64)] {
        match self {
            Self::Time => &[
                ("s", 1.0),
                ("ms", 1e-3),
                ("us", 1e-6),
                ("µs", 1e-6),
                ("ns", 1e-9),
                ("min", 60.0),
            ],
            Self::Length => &[
                ("m", 1.0),
                ("mm", 1e-3),
                ("cm", 1e-2),
                ("um", 1e-6),
                ("µm", 1e-6),
            ],
            Self::Angle => &[
                ("rad", 1.0),
                ("deg", std::f64::consts::PI / 180.0),
                ("mrad", 1e-3),
            ],
            Self::Ratio => &[],
        }
    }
}

/// A column that a recording may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Quantity {
    /// Name without the unit.
    pub(super) name: &'static str,
    dimension: Dimension,
    /// Whether its cells hold lists of points instead of one number.
    pub(super) is_list: bool,
}

const fn quantity(name: &'static str, dimension: Dimension) -> Quantity {
    Quantity {
        name,
        dimension,
        is_list: false,
    }
}

/// All columns that are known.
pub(super) const KNOWN: [Quantity; 26] = [
    quantity("t", Dimension::Time),
    quantity("base_x", Dimension::Length),
    quantity("base_y", Dimension::Length),
    quantity("base_z", Dimension::Length),
    quantity("base_qx", Dimension::Ratio),
    quantity("base_qy", Dimension::Ratio),
    quantity("base_qz", Dimension::Ratio),
    quantity("base_qw", Dimension::Ratio),
    quantity("guide_x", Dimension::Length),
    quantity("guide_y", Dimension::Length),
    quantity("guide_z", Dimension::Length),
    quantity("guide_qx", Dimension::Ratio),
    quantity("guide_qy", Dimension::Ratio),
    quantity("guide_qz", Dimension::Ratio),
    quantity("guide_qw", Dimension::Ratio),
    quantity("tip_x", Dimension::Length),
    quantity("tip_y", Dimension::Length),
    quantity("tip_z", Dimension::Length),
    quantity("axis_x", Dimension::Ratio),
    quantity("axis_y", Dimension::Ratio),
    quantity("axis_z", Dimension::Ratio),
    quantity("sigma", Dimension::Length),
    quantity("axis_sigma", Dimension::Angle),
    quantity("inserted", Dimension::Length),
    quantity("roll", Dimension::Angle),
    Quantity {
        name: "points",
        dimension: Dimension::Length,
        is_list: true,
    },
];

impl Quantity {
    /// Whether a recording does without it, so that it may be unknown in single rows.
    pub(super) fn is_optional(self) -> bool {
        const OPTIONAL: [&str; 11] = [
            "axis_x",
            "axis_y",
            "axis_z",
            "sigma",
            "axis_sigma",
            "inserted",
            "roll",
            "sd_x",
            "sd_y",
            "sd_z",
            "samples",
        ];
        OPTIONAL.contains(&self.name)
    }

    /// What else than a number in its unit may stand in its place, in words.
    pub(super) fn remedy(self) -> &'static str {
        if self.dimension == Dimension::Time {
            "write seconds (`t_s`), of any clock"
        } else {
            "write a number, as 0.25 or 1e-3, or remove the row"
        }
    }

    /// Name with the SI unit, as the documentation writes it.
    pub(super) fn header(self) -> String {
        match self.dimension.units().first() {
            Some((unit, _)) => format!("{}_{unit}", self.name),
            None => self.name.to_owned(),
        }
    }
}

/// All columns of a table of a needle in air, its guide at known places.
pub(super) const IN_AIR: [Quantity; 14] = [
    quantity("depth", Dimension::Length),
    quantity("guide_x", Dimension::Length),
    quantity("guide_y", Dimension::Length),
    quantity("guide_z", Dimension::Length),
    quantity("tip_x", Dimension::Length),
    quantity("tip_y", Dimension::Length),
    quantity("tip_z", Dimension::Length),
    quantity("axis_x", Dimension::Ratio),
    quantity("axis_y", Dimension::Ratio),
    quantity("axis_z", Dimension::Ratio),
    quantity("sd_x", Dimension::Length),
    quantity("sd_y", Dimension::Length),
    quantity("sd_z", Dimension::Length),
    quantity("samples", Dimension::Ratio),
];

/// What a header says: a quantity and the factor of its unit, or a column that is left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Header {
    Known(Quantity, f64),
    LeftOut,
}

/// Understands a column's header among those that are `known`; the error says what to write instead.
pub(super) fn understand(header: &str, known: &[Quantity]) -> Result<Header, String> {
    let name = normalised(header);
    if name.is_empty() || header.trim().starts_with('_') {
        return Ok(Header::LeftOut);
    }
    for &quantity in known {
        let units = quantity.dimension.units();
        if units.is_empty() && name == quantity.name {
            return Ok(Header::Known(quantity, 1.0));
        }
        let Some(rest) = name.strip_prefix(quantity.name) else {
            continue;
        };
        if rest.is_empty() {
            return Err(format!(
                "column `{header}` has no unit; write {}",
                spelled(quantity)
            ));
        }
        if let Some(unit) = rest.strip_prefix('_').filter(|_| !units.is_empty()) {
            if let Some((_, factor)) = units.iter().find(|(known, _)| *known == unit) {
                return Ok(Header::Known(quantity, *factor));
            }
            // `base_x_inch` is a wrong unit, `axis_sigma_m` another column's name with one.
            if !known
                .iter()
                .any(|other| other.name.len() > quantity.name.len() && name.starts_with(other.name))
                && quantity.name != "t"
            {
                return Err(format!(
                    "column `{header}`: unknown unit `{unit}`; write {}",
                    spelled(quantity)
                ));
            }
        }
    }
    let near = known
        .iter()
        .map(|quantity| quantity.header())
        .map(|known| (strsim::normalized_damerau_levenshtein(&known, &name), known))
        .max_by(|a, b| a.0.total_cmp(&b.0));
    let synonym = synonym(&name).filter(|name| known.iter().any(|q| q.header() == *name));
    let hint = match synonym.or(near.filter(|(near, _)| *near > 0.5).map(|(_, k)| k)) {
        Some(known) => format!("; did you mean `{known}`?"),
        None => "; docs/LOGS.md lists the columns.".to_owned(),
    };
    Err(format!(
        "unknown column `{header}`{hint} A `_` before its name leaves a column out"
    ))
}

/// What other programs call our columns.
fn synonym(name: &str) -> Option<String> {
    let known = match name {
        "time" | "time_s" | "timestamp" | "stamp" | "secs" | "seconds" | "time_sec" => "t_s",
        "depth" | "depth_m" | "depth_mm" | "insertion" | "insertion_depth_mm" => "inserted_m",
        "time_ms" | "timestamp_ms" => "t_ms",
        "time_ns" | "timestamp_ns" => "t_ns",
        _ => return None,
    };
    Some(known.to_owned())
}

/// Lower case, with the unit as a suffix however it was written: `Tip X [mm]` is `tip_x_mm`.
fn normalised(header: &str) -> String {
    let mut name = String::new();
    for letter in header.trim().chars().flat_map(char::to_lowercase) {
        let letter = match letter {
            // The micro sign and the Greek letter look the same.
            'μ' => 'µ',
            '°' => {
                name.push_str("deg");
                continue;
            }
            letter if letter.is_alphanumeric() => letter,
            _ => '_',
        };
        if letter != '_' || !name.ends_with('_') {
            name.push(letter);
        }
    }
    // Brackets became underscores.
    name.trim_matches('_').to_owned()
}

fn spelled(quantity: Quantity) -> String {
    let names: Vec<String> = quantity
        .dimension
        .units()
        .iter()
        .take(3)
        .map(|(unit, _)| format!("`{}_{unit}`", quantity.name))
        .collect();
    names.join(" or ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(header: &str) -> (&'static str, f64) {
        match understand(header, &KNOWN) {
            Ok(Header::Known(quantity, factor)) => (quantity.name, factor),
            other => panic!("{header}: {other:?}"),
        }
    }

    #[test]
    fn units_are_read_from_the_suffix_however_it_is_written() {
        for header in [
            "tip_x_mm",
            "Tip_X_MM",
            "tip x [mm]",
            "tip_x (mm)",
            "tip-x/mm",
        ] {
            assert_eq!(known(header), ("tip_x", 1e-3), "{header}");
        }
        assert_eq!(known("t_ns"), ("t", 1e-9));
        assert_eq!(known("axis_sigma_mrad"), ("axis_sigma", 1e-3));
        assert!((known("roll_deg").1 - 1_f64.to_radians()).abs() < 1e-15);
        assert_eq!(known("base_qw"), ("base_qw", 1.0));
        assert_eq!(known("sigma_um"), ("sigma", 1e-6));
        assert_eq!(understand("_note", &KNOWN), Ok(Header::LeftOut));
    }

    #[test]
    fn what_is_not_understood_says_what_to_write() {
        for (header, expected) in [
            ("tip_x", "has no unit; write `tip_x_m` or `tip_x_mm`"),
            ("tip_x_inch", "unknown unit `inch`; write `tip_x_m`"),
            ("tipp_x_m", "did you mean `tip_x_m`?"),
            ("time", "did you mean `t_s`?"),
            ("base_qa", "did you mean `base_q"),
            ("heart_rate", "docs/LOGS.md lists the columns"),
            ("axis_sigma_m", "unknown unit `m`; write `axis_sigma_rad`"),
        ] {
            let problem = understand(header, &KNOWN).unwrap_err();
            assert!(problem.contains(expected), "{header}: {problem}");
        }
    }
}
