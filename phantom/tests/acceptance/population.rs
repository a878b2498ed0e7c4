//! The frozen population: its text, and the paper's two uncontrolled misses inside it.

use phantom::Settings;
use phantom::experiment::uncontrolled;

/// FNV-1a, 64 bits.
fn hash(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[test]
fn the_population_is_frozen() {
    let hashes = [
        include_str!("../../data/population.toml"),
        include_str!("../../data/population-compliant.toml"),
    ]
    .map(hash);
    // Controllers are judged on it: it was fitted once, before any was tuned.
    assert_eq!(
        hashes,
        [0xb475_6504_da1d_2d39, 0x3be7_31c5_22cf_27c9],
        "{hashes:#018x?}"
    );
}

#[test]
fn the_uncontrolled_misses_of_the_paper_lie_inside_the_central_band() {
    for name in ["paper", "paper-compliant"] {
        let settings = Settings::preset(name).unwrap();
        let runs: Vec<_> = (1..=100)
            .map(|seed| uncontrolled(&settings, seed, 1e-3, 0.1).unwrap())
            .collect();
        for (target, paper_mm, value) in [
            (
                "aligned",
                7.6,
                runs.iter().map(|r| r.aligned * 1e3).collect::<Vec<_>>(),
            ),
            (
                "shifted",
                4.9,
                runs.iter().map(|r| r.shifted * 1e3).collect(),
            ),
        ] {
            let mut sorted = value;
            sorted.sort_by(f64::total_cmp);
            let (p5, p50, p95) = (sorted[5], sorted[50], sorted[94]);
            println!("{name} {target}: 5/50/95 % = {p5:.2}/{p50:.2}/{p95:.2} mm, paper {paper_mm}");
            assert!(p5 < paper_mm && paper_mm < p95, "{name} {target}");
        }
    }
}
